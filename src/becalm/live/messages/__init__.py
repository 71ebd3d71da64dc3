"""Read messages with batches of rows, sort them by their row numbers, and encode such messages."""
