"""The specification: numbered equations in plain NumPy, never optimised."""
