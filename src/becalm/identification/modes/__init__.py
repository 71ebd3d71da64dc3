"""Identify the modes of a channel (interacting multiple models, IMM) from a record."""
