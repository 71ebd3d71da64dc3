"""A filter that is the library's own channel: its source, and one file of constants."""
