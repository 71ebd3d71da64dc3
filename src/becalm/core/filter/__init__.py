"""Filters and smoothers for one channel or several; the C kernel does the arithmetic."""
