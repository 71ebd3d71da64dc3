"""Clean live streams for weeks: sources, sinks, the runner between them, and the journal."""
