"""Linear systems of a user's own, and disturbance sets proved for nonlinear ones."""
