"""Modes, one of which is in force at a time."""
