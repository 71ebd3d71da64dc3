"""Detect faults of a sensor, its measurements, their times and their noise."""
