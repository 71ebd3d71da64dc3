"""Interacting multiple models (IMM): filters and smoothers with several modes, of which one is in force at a time."""
