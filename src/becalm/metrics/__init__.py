"""Measures of the quality of a signal, with and without a known true signal."""
