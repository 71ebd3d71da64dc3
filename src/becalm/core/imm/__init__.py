"""Interacting multiple models (IMM): filters and smoothers with several modes, one of which is in force at a time."""
