"""A settled gain in whole numbers."""
