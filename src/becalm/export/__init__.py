"""Export a filter: as C with its verification, as second-order sections, as JSON or for SciPy."""
