"""Tune one recipe for each class of a lake's sensors, and report the sensors that differ from their class."""

from becalm.fleet.tuning.lake import LakeTuningOptions, TunedLake, tune

__all__ = ["LakeTuningOptions", "TunedLake", "tune"]
