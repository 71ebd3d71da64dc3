"""Read and write CSV files, whole or block by block: detect separator, columns and rate."""
