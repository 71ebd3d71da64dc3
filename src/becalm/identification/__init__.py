"""Identify the process noise Q and the measurement noise R from data."""
