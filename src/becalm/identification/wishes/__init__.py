"""Tune a filter to a person's wish: one setting, the trade-off of noise against lag, and the gain of a delay."""
