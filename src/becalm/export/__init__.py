"""The same filter elsewhere: as C with its proof, as second-order sections, as JSON."""
