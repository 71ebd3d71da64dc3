"""Read and write files of arrays (HDF5, MAT and NPZ), and group the arrays that belong together."""
