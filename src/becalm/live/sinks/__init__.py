"""Where clean streams go, one transport a file."""
