"""The car paper (Sensors 2001)."""
