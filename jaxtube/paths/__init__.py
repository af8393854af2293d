"""Paths of real robots: cleaned, cut into missions, and given speeds that the wheels can run."""
