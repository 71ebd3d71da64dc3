"""Export a filter as the library's own C: its sources, and one file of constants per export."""
