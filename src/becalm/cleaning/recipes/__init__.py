"""Recipes: the parameters of each channel, their tables, and their conversion to steps."""
