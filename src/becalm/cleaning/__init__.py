"""Recipe and pipeline: the only room where the others meet."""
