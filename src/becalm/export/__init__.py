"""Export filters: as verified C, as second-order sections, as JSON, or as a Python module for SciPy."""
