"""A channel that is smoothed in stretches is smoothed as a whole, however its rows are pushed."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import run_filter
from becalm.core.filter.gate import Gate
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.filter.smoothing import run_smoother
from becalm.core.model.components import motion, oscillator, returning_motion
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows

ROWS = 200_000  # of which several stretches are told before the record ends
EQUAL = 1e-12  # as surely as it knows the future before it tells anything


def even(rows: int) -> Floats:
    elapsed = np.ones(rows)
    elapsed[0] = 0.0
    return elapsed


def record(kind: str) -> tuple[Floats, Floats]:
    """Readings and the steps before them: a walk in noise, with what `kind` says."""
    rng = np.random.default_rng(5)
    z, elapsed = np.cumsum(0.1 * rng.normal(size=ROWS)) + rng.normal(size=ROWS), even(ROWS)
    if kind == "holes":
        z[rng.random(ROWS) < 0.01], z[1010:1100], z[16_300:17_500] = np.nan, np.nan, np.inf
    elif kind == "gaps":
        elapsed[[700, 1024, 16384, 50_000]] = 3.0, 2.0, 40.0, 7.0
    elif kind == "stamps":
        elapsed[1:] = rng.exponential(size=ROWS - 1)
    elif kind == "late":
        z[:25_000] = np.nan
    elif kind == "one early":
        z[1:25_000] = np.nan
    return z, elapsed


def flow(
    order: int, density: float, readings: tuple[Floats, Floats], cuts: list[int], gate: Gate | None = None
) -> tuple[Floats, Floats, SmoothedFlow]:
    shown: list[Floats] = []
    made = SmoothedFlow(motion(order, density), 1.0, judge=lambda nu, sigma: shown.append(nu / sigma), gate=gate)
    z, elapsed = readings
    told = []
    for start, stop in zip([0, *cuts], [*cuts, len(z)], strict=True):
        told += made.push(z[start:stop], elapsed[start:stop])
    assert told or not np.isfinite(z[: ROWS // 2]).any()
    told += made.finish()
    assert sum(map(len, shown)) == len(z)
    return np.concatenate([part.signal for part in told]), np.concatenate([part.sigma for part in told]), made


KINDS = ["none", "holes", "gaps", "stamps", "late", "one early"]
CUTS = {"blocks": [65536, 131072], "odd": [1, 2, 5, 1000, 100_001, 140_000], "empty": [0, 120_000, 120_000]}


@pytest.mark.parametrize("kind", KINDS)
def test_stretches_are_the_whole(kind: str) -> None:
    z, elapsed = record(kind)
    part = motion(2, 1e-4)
    line = elapsed_timeline(part, 1.0, elapsed)
    model = part.to_model(1.0, 1.0)
    whole = run_filter(model, line, z[:, np.newaxis]).estimate
    expected = run_smoother(model, line, z[:, np.newaxis])
    signal, sigma, made = flow(2, 1e-4, (z, elapsed), [])
    assert np.array_equal(np.isnan(signal), np.isnan(expected.signal[:, 0]))
    largest, off = np.abs(z[np.isfinite(z)]).max(), np.abs(signal - expected.signal[:, 0])
    assert (off <= EQUAL * largest + 1e-11 * expected.sigma[:, 0]).all()
    np.testing.assert_allclose(sigma, expected.sigma[:, 0], rtol=1e-10)
    assert made.log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-12)


@pytest.mark.parametrize("cuts", CUTS.values(), ids=CUTS)
@pytest.mark.parametrize("kind", KINDS)
def test_any_cut_gives_the_same_bits(kind: str, cuts: list[int]) -> None:
    z, elapsed = record(kind)
    z[[1023, 70_000]] += 60.0
    z[100_000:] += 30.0
    cut, whole = (flow(2, 1e-4, (z, elapsed), where, Gate(5.0)) for where in (cuts, []))
    assert np.array_equal(cut[0], whole[0], equal_nan=True)
    assert np.array_equal(cut[1], whole[1])
    assert cut[2].settled_row == whole[2].settled_row
    assert cut[2].log_likelihood == whole[2].log_likelihood


def test_a_large_offset_costs_no_digits() -> None:
    """What moves keeps the digits that it has beside the offset in the readings themselves."""
    z, elapsed = record("none")
    z = np.round(z * 2.0**20) / 2.0**20  # so that the offset itself rounds nothing
    near = flow(5, 1e-9, (z, elapsed), [])[0]
    far = flow(5, 1e-9, (z + 2.0**20, elapsed), [])[0]
    np.testing.assert_allclose(far - 2.0**20, near, rtol=0, atol=2.0**-31)


def test_a_smoother_tells_as_soon_as_the_future_is_forgotten() -> None:
    z, elapsed = record("none")
    made = SmoothedFlow(motion(1, 1.0), 1.0)
    assert made.push(z[:65536], elapsed[:65536]) == []
    told = made.push(z[65536 : 65536 + 16384], elapsed[65536 : 65536 + 16384])
    assert sum(len(part.signal) for part in told) == 65536
    assert sum(len(part.signal) for part in made.finish()) == 16384


def test_a_smoother_that_never_forgets_waits_for_all() -> None:
    z, elapsed = record("none")
    made = SmoothedFlow(motion(2, 0.0), 1.0)
    for start in range(0, ROWS, 10_000):
        assert made.push(z[start : start + 10_000], elapsed[start : start + 10_000]) == []
    signal = np.concatenate([part.signal for part in made.finish()])
    line = np.polynomial.Polynomial.fit(np.arange(ROWS), z, 1)(np.arange(ROWS))
    np.testing.assert_allclose(signal, line, rtol=1e-9, atol=1e-9)


def test_a_channel_in_which_nothing_arrives_stays_untold() -> None:
    z, elapsed = np.full(1000, np.nan), even(1000)
    signal, sigma, _ = flow(2, 1e-2, (z, elapsed), [256, 512])
    assert np.isnan(signal).all()
    assert np.isinf(sigma).all()


def test_a_buffer_may_be_written_into_again() -> None:
    z, elapsed = record("none")
    made, buffer, told = SmoothedFlow(motion(1, 0.1), 1.0), np.empty(1000), list[EstimatedRows]()
    for start in range(0, ROWS, 1000):
        buffer[:] = z[start : start + 1000]
        told += made.push(buffer, np.ones(1000))
    signal = np.concatenate([part.signal for part in [*told, *made.finish()]])
    assert np.array_equal(signal, flow(1, 0.1, (z, elapsed), [])[0])


@pytest.mark.parametrize("seed", range(40))
def test_sigma_where_a_reading_came_is_that_of_a_reading_at_the_most_and_never_0(seed: int) -> None:
    """Where states are known by their sum alone, where a tone fades within a step, beside jumps, at the first rows."""
    rng = np.random.default_rng(seed)
    density, damping = 10 ** rng.uniform(-6, 1), 10 ** rng.uniform(-2.5, -1)
    part = returning_motion(int(rng.integers(1, 6)), density, damping)
    if seed % 2:
        part = motion(1, 3e-7) + oscillator(rng.uniform(0.05, 0.45), 0.019, 0.0011)
    z, elapsed = rng.normal(size=40), rng.choice([1.0, 1.0, 1.0, 7.0, 50.0, 300.0], 40)
    if seed % 4 < 2:
        z[rng.random(40) < 0.15] += 80 * rng.normal()
    z[rng.random(40) < 0.1] = np.nan
    made = SmoothedFlow(part, 1.0, gate=Gate(5.0) if seed % 4 < 2 else None)
    told = EstimatedRows.joined([*made.push(z, elapsed), *made.finish()])
    used = np.isfinite(z) & np.isfinite(told.signal) & (told.verdicts == Verdict.USED)
    assert used.sum() > 10
    assert (told.sigma[used] > 1e-3).all()
    assert (told.sigma[used] <= 1 + 1e-6).all()


def test_rejects_at_the_end_of_a_stretch_wait_for_what_follows() -> None:
    """Though a stretch ends amid them: they turn out to be a step."""
    z, elapsed = record("none")
    z[16384 - 3 :] += 60.0
    made = SmoothedFlow(motion(2, 1e-4), 1.0, gate=Gate(5.0))
    told = EstimatedRows.joined([*made.push(z, elapsed), *made.finish()])
    assert told.verdicts[16384 - 3] == Verdict.STEP
    assert not told.verdicts[16384 - 2 : 20_000].any()
    assert len(told.signal) == ROWS
