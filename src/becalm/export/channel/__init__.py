"""Export a filter as the library's own C sources, with one file of constants for each export."""
