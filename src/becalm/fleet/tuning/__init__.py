"""Recipes for a lake: one for each class of its sensors, and those named that are unlike their class."""

from becalm.fleet.tuning.lake import Asked, Tuned, tune

__all__ = ["Asked", "Tuned", "tune"]
