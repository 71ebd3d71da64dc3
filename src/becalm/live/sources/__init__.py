"""The sources of streams, one module for each transport."""
