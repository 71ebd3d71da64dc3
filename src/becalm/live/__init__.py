"""A stream through a recipe, for weeks: sources and sinks, one transport a file; what runs between them; the journal."""
