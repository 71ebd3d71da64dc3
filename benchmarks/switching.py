"""Still when it is still, quick when it moves: a filter that switches against filters of a fixed gain.

White noise with the variances of Table 1 of the IMU paper at 10 kHz, at rest for 30 s, then a step. becalm finds the
modes in each record by itself, and filters it causally. Rest noise is the rms error over the last 15 s before the
step, and t90 the time from the step until the output first passes nine tenths of it; medians over 20 seeds. Beside
it the paper's optimum (480 ms) and the fixed filter that has the same rest noise.

Then, on real recordings of a sensor that rests between motions: the rest noise over that of the fixed filter tuned by
likelihood, and during motion the rms difference from that filter's smoother, over the fixed filter's own. Rest is
what the recording's mask says, in windows of a second, a second away from motion; the median of their standard
deviations.

Run: python benchmarks/switching.py [-o docs/switching.md] [--data FOLDER] [--seeds 20]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import becalm
from becalm.core.closed_forms import first_order_gain
from becalm.noise.likelihood import Evidence, Tuning, tune_motion
from pages import publish

Floats = NDArray[np.float64]

RATE_HZ = 10_000.0
REST_S, AFTER_S = 30.0, 1.0
VARIANCES = {"accelerometer": 1.847e-4, "gyroscope": 2.2e-2}
STEPS_IN_STD = (0.2, 0.05, 0.02, 0.005)
