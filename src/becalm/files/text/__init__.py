"""Parse the cells and headers of text files, and report cells that cannot be parsed."""
