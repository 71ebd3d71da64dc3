"""Parse rows from lines of CSV or JSON, and skip other text between them."""
