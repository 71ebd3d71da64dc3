"""Noise at rest: found by itself, by Allan deviations, and as data sheets say it."""
