"""Where streams come from, one transport a file."""
