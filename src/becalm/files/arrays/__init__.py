"""Files of arrays: HDF5, MAT and NPZ, and which of their arrays belong together."""
