"""Steady-state filters: gain, frequency response, bandwidth, lag and noise gain."""
