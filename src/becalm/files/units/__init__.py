"""Read units from headers, names and cells, and convert them."""
