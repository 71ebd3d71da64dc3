"""Batches of rows as messages: read, put in order by their numbers, and made."""
