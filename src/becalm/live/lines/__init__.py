"""Rows from lines of CSV or JSON, whatever else stands between them."""
