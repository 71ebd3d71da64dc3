"""What is gathered of a recording: bounded, at the right time, and as wide as it says."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.core.rows import EstimatedRows
from becalm.report.data.envelope import Envelope, Means
from becalm.report.gathering import WIDTH, ChannelGathering, Gathering
from drawing import draw


def told_of(signal: Floats, sigma: float = 0.5) -> EstimatedRows:
    rows = len(signal)
    return EstimatedRows(signal, np.full(rows, sigma), np.empty((0, rows)), np.zeros(rows, np.int8))


def arrays_of(held: object, seen: set[int]) -> int:
    """Count the bytes of all arrays that something holds, whatever holds them."""
    if id(held) in seen:
        return 0
    seen.add(id(held))
    if isinstance(held, np.ndarray):
        return held.nbytes if held.base is None else max(held.nbytes, held.base.nbytes)
    if isinstance(held, dict):
        return sum(arrays_of(one, seen) for one in held.values())
    if isinstance(held, list | tuple):
        return sum(arrays_of(one, seen) for one in held)
    return sum(arrays_of(one, seen) for one in vars(held).values()) if hasattr(held, "__dict__") else 0


def gathered(rows: int, block: int) -> Gathering:
    rng, gathering = np.random.default_rng(2), Gathering(rows, 0.01, 2)
    for start in range(0, rows, block):
        count = min(block, rows - start)
        signal, noise = rng.normal(size=(2, count))
        gathering.add([signal + noise, noise], np.ones(count), [told_of(signal), told_of(noise)])
        for channel in gathering.channels:
            channel.add_innovations(noise, np.ones(count))
    return gathering


def test_memory_does_not_grow_with_the_rows() -> None:
    short, long = (arrays_of(gathered(rows, 1 << 15), set()) for rows in (100_000, 1_000_000))
    assert long < 1.1 * short
    assert long < 1_000_000


def test_a_band_is_two_sigma_to_each_side() -> None:
    gathering, signal = Gathering(3000, 0.01, 1), np.sin(np.arange(3000.0))
    gathering.add([signal], np.ones(3000), [told_of(signal, 0.25)])
    (channel,) = gathering.channels
    assert gathering.rows_each == 1
    np.testing.assert_allclose(channel.band.high - channel.clean.high, WIDTH * 0.25, rtol=1e-12)
    np.testing.assert_allclose(channel.clean.low - channel.band.low, WIDTH * 0.25, rtol=1e-12)


def test_what_no_sensor_gives_leaves_room_for_the_others() -> None:
    z, verdicts = np.array([1.0, 1e300, 2.0, np.inf, 3.0]), np.zeros(5, np.int8)
    verdicts[[1, 3]] = Verdict.OVERRANGE, Verdict.NONFINITE
    gathering = Gathering(5, 1.0, 1)
    gathering.add([z], np.ones(5), [told_of(np.arange(5.0))._replace(verdicts=verdicts)])
    np.testing.assert_array_equal(gathering.channels[0].readings.high, [1.0, np.nan, 2.0, np.nan, 3.0])
    assert z[1] == 1e300, "the readings themselves stay"


@pytest.mark.parametrize("rows", [300, 1100, 10_001, 50_000])
@pytest.mark.parametrize("block", [256, 1 << 18])
def test_innovations_are_drawn_when_they_were(rows: int, block: int) -> None:
    """Wild readings at 80 % of a recording with a gap stand there in the figure too."""
    rng = np.random.default_rng(3)
    z, step_s = np.cumsum(rng.normal(0, 0.05, rows)) + rng.normal(0, 0.3, rows), 0.01
    at = int(0.8 * rows)
    times_s = np.arange(rows) * step_s
    times_s[rows // 2 :] += 0.3 * rows * step_s
    recording = Recording(z, names=["a"], units=["m"], times_s=times_s)
    quiet = draw(recording).recipe
    ungated = quiet.channel[0].model_copy(update={"gate": None, "switching": None})
    z[at : at + 10] += 8.0 * rng.choice([-1.0, 1.0], 10)
    wild = draw(
        Recording(z, names=["a"], units=["m"], times_s=times_s),
        quiet.model_copy(update={"channel": (ungated,)}),
        block=block,
    )
    (found,) = (figure for figure in wild.pictures.channel(0).narrow if figure.name == "1-a-nis")
    curve = found.layers[0]
    x, nis = curve.x, curve.y  # type: ignore[union-attr]
    assert np.isfinite(nis).sum() <= 200
    assert np.isfinite(x).all()
    assert x[-1] == pytest.approx(times_s[-1], rel=0.02), "to the end"
    assert x[np.nanargmax(nis)] == pytest.approx(times_s[at], abs=(rows // 200 + 10) * step_s)


def test_the_mean_of_right_innovations_is_one_and_within_its_limits() -> None:
    channel = ChannelGathering(100_000, 0.01, 3000)
    channel.add_innovations(np.random.default_rng(5).normal(0, 0.2, 100_000), np.full(100_000, 0.2))
    assert isinstance(channel.nis, Means)
    assert channel.nis.result().mean() == pytest.approx(1.0, abs=0.02)
    assert channel.nis.seen.sum() == 100_000


@pytest.mark.parametrize("block", [1, 7, 100, 5000])
def test_blocks_change_nothing_that_is_drawn_over_time(block: int) -> None:
    whole, cut = gathered_drive(5000), gathered_drive(block)
    for name in ("readings", "clean", "band"):
        one, other = getattr(whole.channels[0], name), getattr(cut.channels[0], name)
        assert isinstance(one, Envelope)
        np.testing.assert_array_equal(one.low, other.low)
        np.testing.assert_array_equal(one.high, other.high)
    np.testing.assert_allclose(whole.times.low, cut.times.low, rtol=1e-12)


def gathered_drive(block: int) -> Gathering:
    z, elapsed = np.random.default_rng(8).normal(size=5000), np.ones(5000)
    gathering = Gathering(5000, 0.01, 1)
    for start in range(0, 5000, block):
        rows = slice(start, start + block)
        gathering.add([z[rows]], elapsed[rows], [told_of(z[rows] / 2)])
    return gathering
