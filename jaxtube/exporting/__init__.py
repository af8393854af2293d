"""Controllers that leave the program: NumPy, C99, and what proves them again."""
