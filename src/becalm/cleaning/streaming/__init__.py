"""Clean the rows of a stream as they are measured, and change its recipe while it runs."""
