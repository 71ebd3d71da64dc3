"""Delimited text: bytes to text, text to cells, cells to columns."""
