"""`export`: the controller of a design as NumPy and C99."""
