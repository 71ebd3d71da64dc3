"""Tune recipes for a lake: one for each class of its sensors. Report the sensors that differ from their class."""

from becalm.fleet.tuning.lake import LakeTuningOptions, TunedLake, tune

__all__ = ["LakeTuningOptions", "TunedLake", "tune"]
