"""The reference filters in plain NumPy with numbered equations; never optimised."""
