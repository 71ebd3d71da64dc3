"""Recipes for a lake: one for each class of its sensors, and those named that are unlike their class."""

from becalm.fleet.tuning.lake import LakeTuningOptions, Tuned, tune

__all__ = ["LakeTuningOptions", "Tuned", "tune"]
