"""Filters whose gain has settled, in an engineer's words."""
