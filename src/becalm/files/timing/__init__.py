"""Find the time of rows: choose the time column, read it, and correct what loggers do to it."""
