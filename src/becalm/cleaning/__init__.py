"""Recipes, tuning and cleaning: the package that combines sensors, identification, filters and metrics."""
