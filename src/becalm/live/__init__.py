"""A stream through a recipe, for weeks: sources, sinks, what runs between them, and the journal."""
