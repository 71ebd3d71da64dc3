"""Recipes for a lake: one for each class of its sensors, and those named that are unlike their class."""

from becalm.fleet.tuning.lake import LakeTuningOptions, TunedLake, tune

__all__ = ["LakeTuningOptions", "TunedLake", "tune"]
