"""Shocks, reversals and impacts are motion: none of their readings is a spike, though the record is at rest else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from becalm.cleaning.pipeline import clean
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording

ROWS = 3000
GAITMAP = Path(__file__).parents[2].parent / "shared" / "data" / "gaitmap" / "imu_sample.csv"


def dropped(rate_hz: float, width_s: float, size: float) -> Floats:
    """Return a half-sine shock and the ringing after it, as on a drop tower."""
    after_s = np.arange(ROWS) / rate_hz - 0.4 * ROWS / rate_hz
    pulse = np.where((after_s > 0) & (after_s < width_s), size * np.sin(np.pi * after_s / width_s), 0.0)
    late_s = np.maximum(after_s, 0)
    return pulse + 0.3 * size * np.exp(-late_s / (2 * width_s)) * np.sin(6 * np.pi * late_s / width_s)


def reversed_by_hand(smooth: bool) -> Floats:
    """Return a hand-held sensor's turns to and fro, with rests between them."""
    rng, turns = np.random.default_rng(5), list[Floats]()
    while sum(map(len, turns)) < ROWS:
        k = np.arange(rng.integers(300, 700))
        rise = np.clip(np.minimum(k, k[::-1]) / rng.integers(20, 60), 0, 1)
        turn = rng.choice([-1, 0, 1]) * rng.uniform(50, 300)
        turns.append(turn * (rise**2 * (3 - 2 * rise) if smooth else rise))
    return np.concatenate(turns)[:ROWS]


def struck() -> Floats:
    """Return impacts, one after another, each of which rings for a few readings."""
    rng, z = np.random.default_rng(6), np.zeros(ROWS)
    for begin in range(400, ROWS - 300, 500):
        k = np.arange(ROWS - begin)
        z[begin:] += rng.uniform(50, 400) * np.exp(-k / 12) * np.sin(2 * np.pi * k / 9 + 0.3)
    return z


MOTIONS = {
    **{
        f"drop of {size:g} in {1e3 * width_s:g} ms at {rate_hz:g} Hz": dropped(rate_hz, width_s, size)
        for rate_hz, width_s, size in (
            (5000.0, 0.002, 50.0),
            (5000.0, 0.011, 1000.0),
            (20_000.0, 0.002, 1000.0),
            (20_000.0, 0.011, 50.0),
        )  # each pair of two of them
    },
    "smooth reversals": reversed_by_hand(True),
    "jerky reversals": reversed_by_hand(False),
    "impacts": struck(),
}


@pytest.mark.parametrize(
    ("kind", "causal"),
    [
        (kind, causal)
        for k, kind in enumerate(MOTIONS)
        for causal in (True, False)
        if "drop" not in kind or causal == (k % 4 in (0, 3))
    ],
)  # each drop in one of the modes, one of each size and one of each width in either
def test_no_reading_of_a_motion_is_a_spike(kind: str, causal: bool) -> None:
    truth = MOTIONS[kind]
    out = clean(Recording(truth + np.random.default_rng(1).normal(size=ROWS), rate_hz=5000.0), causal=causal)
    (verdicts,) = out.verdicts.values()
    assert not np.any(verdicts == Verdict.SPIKE)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize(("hz", "lasts_s"), [(60.0, 0.05), (60.0, 0.2), (90.0, 0.1)])
def test_a_quick_shock_at_rest_is_followed(hz: float, lasts_s: float, causal: bool) -> None:
    after_s = np.arange(1500) / 200 - 3.0
    ringing = 20 * np.exp(-2 * np.maximum(after_s, 0) / lasts_s) * np.cos(2 * np.pi * hz * after_s)
    truth = np.where((after_s > 0) & (after_s < lasts_s), ringing, 0.0)
    out = clean(Recording(truth + 0.05 * np.random.default_rng(0).normal(size=1500), rate_hz=200.0), causal=causal)
    assert np.abs(out.signal.samples[:, 0] - truth).max() < 0.3


@pytest.mark.parametrize("causal", [True, False])
def test_steps_of_a_walk_are_no_spikes(causal: bool) -> None:
    """A foot's gyroscope at a heel strike, of which one reading in twenty was left out."""
    if not GAITMAP.exists():
        pytest.skip(f"the recordings are not beside the project ({GAITMAP.name})")
    table = np.loadtxt(GAITMAP, delimiter=",", skiprows=2)
    out = clean(Recording(table[:, 9], rate_hz=204.8), causal=causal)
    (verdicts,) = out.verdicts.values()
    assert not np.any(verdicts == Verdict.SPIKE)
