"""The reference filters: plain NumPy with numbered equations, which is never optimised."""
