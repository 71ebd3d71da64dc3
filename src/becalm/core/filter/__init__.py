"""Filters and smoothers of a channel, and of several, over the kernel in C."""
