"""Gross outliers and held readings, in every path: smoothed, causal, with a lag, and as a stream."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from becalm import Recording, clean, tune
from becalm.cleaning.pipeline import Cleaned
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Floats, Integers
from becalm.core.reading_verdicts import Verdict

ROWS, RATE_HZ = 2500, 100.0
T = np.arange(ROWS) / RATE_HZ
TRUTH = 20 + 5 * np.sin(2 * np.pi * 0.2 * T) + 2 * np.sin(2 * np.pi * 0.33 * T)
WILD = {
    "none": {},
    "the first": {0: 65535.0},
    "the first two": {0: 65535.0, 1: -8388608.0},
    "amid": {1700: 51169.0},
    "the last": {ROWS - 1: -1e9},
    "ten zeros": dict.fromkeys(range(1000, 1010), 0.0),
    "ten times none": dict.fromkeys(range(1000, 1010), -999.0),
    "here and there": {row: 1e6 * (-1) ** row for row in range(50, ROWS, 97)},
}


def readings(wild: dict[int, float]) -> Floats:
    z: Floats = np.round(TRUTH + 0.3 * np.random.default_rng(0).normal(size=ROWS), 3)
    z[list(wild)] = list(wild.values())
    return z


def recording(z: Floats) -> Recording:
    return Recording(z, names=["v"], rate_hz=RATE_HZ)


@cache
def cleaned(name: str, mode: str) -> Cleaned:
    lag_s = 0.2 if mode == "lagged" else None
    return clean(recording(readings(WILD[name])), causal=mode == "causal", lag_s=lag_s)


@pytest.mark.parametrize("name", WILD)
@pytest.mark.parametrize("mode", ["smoothed", "causal", "lagged"])
def test_outliers_are_left_out_and_the_rest_is_as_without_them(name: str, mode: str) -> None:
    z, rows, out = readings(WILD[name]), sorted(WILD[name]), cleaned(name, mode)
    assert np.flatnonzero(out.verdicts["v"] == Verdict.OUTLIER).tolist() == rows
    plain = clean(recording(np.where(np.isin(np.arange(ROWS), rows), np.nan, z)), out.recipe)
    assert np.array_equal(out.signal.samples, plain.signal.samples, equal_nan=True)
    assert np.array_equal(out.sigma.samples, plain.sigma.samples)
    error = np.abs(out.signal.samples[:, 0] - TRUTH)
    assert np.nanmax(error) < 1.2, "no farther than readings of noise 0.3"
    assert 0.55 < np.mean(error <= out.sigma.samples[:, 0]) < 0.8


@pytest.mark.parametrize("name", WILD)
def test_a_stream_tells_what_a_causal_file_does(name: str) -> None:
    z, out = readings(WILD[name]), cleaned(name, "causal")
    stream, told = StreamCleaner(out.recipe, 1 / RATE_HZ), []
    for start in range(0, ROWS, 777):
        part = z[start : start + 777]
        told.append(stream.push(part[:, np.newaxis], np.ones(len(part))))
    assert np.array_equal(np.concatenate([one.verdicts[:, 0] for one in told]), out.verdicts["v"])
    assert np.allclose(
        np.concatenate([one.signal[:, 0] for one in told]), out.signal.samples[:, 0], rtol=1e-9, equal_nan=True
    )


def jumping_with_spikes() -> tuple[Floats, Floats, Integers]:
    """Return levels that jump, readings of them with one wild one in a hundred, and the rows of these."""
    rng = np.random.default_rng(12)
    truth = np.repeat(rng.normal(size=40), 200)
    z, rows = truth + 0.05 * rng.normal(size=len(truth)), rng.random(len(truth)) < 0.01
    z[rows] += rng.choice([-1, 1], rows.sum()) * 2.0 ** rng.integers(2, 20, rows.sum())
    return truth, z, np.flatnonzero(rows)


def test_a_causal_bank_knows_that_a_far_reading_is_more_often_wild_than_a_jump() -> None:
    truth, z, rows = jumping_with_spikes()
    recording = Recording(z, names=["a"], rate_hz=100.0)
    recipe = tune(recording, causal=True)
    assert recipe.channel[0].switching is not None
    assert recipe.channel[0].switching.mode[0].wild_share > 1e-3
    error = np.abs(clean(recording, recipe).signal.samples[:, 0] - truth)
    assert np.nanmax(error[rows]) < np.ptp(truth)


def test_a_smoother_whose_outliers_are_found_on_both_sides_loses_no_reading_at_a_jump() -> None:
    truth, z, rows = jumping_with_spikes()
    out = clean(Recording(z, names=["a"], rate_hz=100.0))
    error = np.abs(out.signal.samples[:, 0] - truth)
    jumps = np.flatnonzero(np.diff(truth)) + 1
    near = np.isin(jumps, [row + k for row in rows for k in range(-3, 4)])
    assert error[jumps[~near]].max() < 0.5


@pytest.mark.parametrize("how", [{}, {"causal": True}, {"lag_s": 0.1}])
def test_modes_are_not_misled_by_a_few_values_that_are_no_motion(how: dict[str, Any]) -> None:
    """A tone that comes and goes: its oscillator rang for seconds after the third of some wild values."""
    time = np.arange(3000) / 100
    truth = np.where(time % 20 < 10, 0.0, 5 * np.sin(9 * time))
    z = truth + np.random.default_rng(1).normal(0, 0.1, 3000)
    recipe = tune(Recording(z, rate_hz=100.0), causal=bool(how))
    assert recipe.channel[0].switching is not None
    one = clean(Recording(z, rate_hz=100.0), recipe, **how).signal.samples[:, 0]
    for rows in (1, 3, 10):
        damaged = z.copy()
        damaged[1500 : 1500 + rows] += 1e6
        other = clean(Recording(damaged, rate_hz=100.0), recipe, **how).signal.samples[:, 0]
        away = np.r_[0:1400, 1500 + rows : 3000]
        assert np.abs(one - other)[away].max() < 1.0, "NaN is none either"
        assert np.nanmax(np.abs(one - other)) < 10.0


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("rows", [300, 1000])
@pytest.mark.parametrize("share", [0.25, 0.4])
def test_a_fast_tone_in_a_short_record_is_signal(share: float, rows: int, causal: bool) -> None:
    truth = 3 * np.sin(2 * np.pi * share * np.arange(rows))
    z = truth + np.random.default_rng(0).normal(0, 0.5, rows)
    out = clean(Recording(z, rate_hz=100.0), causal=causal).signal.samples[:, 0]
    assert np.sqrt(np.mean((out - truth) ** 2)) < 0.5 * 0.6
