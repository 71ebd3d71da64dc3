"""Spark's daemon of Python workers, which loads what workers use once, before it forks."""

from __future__ import annotations

import pandas  # noqa: F401
import pyarrow.parquet  # noqa: F401
import pyspark.worker  # noqa: F401
from pyspark.daemon import manager

import becalm.fleet.grouped.cleaning
import becalm.fleet.sensor_cleaning
import becalm.fleet.stream.processor
import becalm.fleet.stretching.cleaning
import becalm.fleet.tuning.sensor_tuning  # noqa: F401

if __name__ == "__main__":
    manager()
