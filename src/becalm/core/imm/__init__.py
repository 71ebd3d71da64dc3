"""Interacting multiple models: several modes, one of which is in force at a time."""
