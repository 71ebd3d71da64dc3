"""CSV: which delimiter, which columns, which rates; whole or block by block."""
