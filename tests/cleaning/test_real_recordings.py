"""Real recordings: hidden readings lie within the stated uncertainty; a model that does not fit is said not to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from becalm.cleaning.pipeline import clean
from becalm.cleaning.tuning import tune
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording

DATA = Path(__file__).parents[2].parent / "shared" / "data"
RECORDINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "car": ("comma2k19/accelerometer.csv", {"delimiter": ",", "skiprows": 1}),
    "speed": ("comma2k19/can_speed.csv", {"delimiter": ",", "skiprows": 1}),
    "imu at rest and turned": ("imu_tk/xsens_acc.mat.txt.gz", {"skiprows": 3000, "max_rows": 3000}),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_hidden_readings_are_foretold(name: str) -> None:
    file, how = RECORDINGS[name]
    path = DATA / file
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({file})")
    table = np.loadtxt(path, **how)
    samples = table[:, 1:]
    hidden = np.zeros(samples.shape, dtype=bool)
    hidden[5:-5:10] = True
    out = clean(Recording(np.where(hidden, np.nan, samples), times_s=table[:, 0]))
    assert np.isfinite(out.signal.samples).all()
    assert (out.sigma.samples > 0).all()
    assert all(np.mean(verdicts == Verdict.SPIKE) < 1e-3 for verdicts in out.verdicts.values()), "motion is cut"
    for c, report in enumerate(out.reports):
        rows = np.flatnonzero(hidden[:, c])
        error = out.signal.samples[rows, c] - samples[rows, c]
        between = (samples[rows - 1, c] + samples[rows + 1, c]) / 2 - samples[rows, c]
        assert report.noise_std is not None
        spread = np.hypot(out.sigma.samples[rows, c], report.noise_std)
        right = bool(0.5 < np.mean((error / spread) ** 2) < 1.5)
        assert right or not report.describes, "sigma is wrong, and not said to be"
        worse = np.mean(error**2) > 1.1 * np.mean(between**2)
        assert not (worse and report.describes), "worse than the mean of the two neighbours, and not said"


@pytest.mark.parametrize(("axis", "causal"), [(0, False), (1, True)])
def test_noise_is_not_less_than_what_rest_shows(axis: int, causal: bool) -> None:
    """A hand-held gyroscope between rests: the flanks of wide tones must not stand for its white noise."""
    path = DATA / "broad" / "04_undisturbed_slow_rotation_with_breaks_A.mat"
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({path.name})")
    from scipy.io import loadmat

    held = loadmat(path, variable_names=["imu_gyr", "movement"])
    turning, still = held["imu_gyr"][:15_000, axis], np.ravel(held["movement"])[:15_000] == 0
    (channel,) = tune(Recording(turning, rate_hz=2000 / 7), causal=causal).channel
    assert channel.noise_std is not None
    at_rest = np.std(np.diff(turning)[still[1:] & still[:-1]]) / np.sqrt(2)
    assert channel.noise_std > at_rest / 2
