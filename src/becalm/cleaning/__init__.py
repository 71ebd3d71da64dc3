"""Recipes, tuning and cleaning; this package combines sensors, identification, filters and metrics."""
