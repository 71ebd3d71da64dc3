"""The sinks of streams, one module for each transport."""
