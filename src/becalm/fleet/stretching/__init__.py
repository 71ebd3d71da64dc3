"""Clean a very long recording in stretches of time. Filters warm up on the rows before a stretch; seams are checked."""
