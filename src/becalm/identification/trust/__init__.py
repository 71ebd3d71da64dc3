"""Estimate how far a tuning can be trusted: its uncertainty, and the correlation time of its errors."""
