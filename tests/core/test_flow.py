"""Flow: a channel in stretches is the channel as a whole, filtered and smoothed."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.filtering import run_filter
from becalm.core.flow import Flow
from becalm.core.gates import Gate
from becalm.core.smoothing import run_smoother
from becalm.core.timeline import elapsed_timeline

ROWS = 6000
EQUAL = 1e-12  # as surely as `Flow` knows N before it tells anything; 3.5e-13 is reached, beside holes


def even(rows: int) -> Floats:
    elapsed = np.ones(rows)
    elapsed[0] = 0.0
    return elapsed


def record(kind: str) -> tuple[Floats, Floats]:
    """Readings and the steps before them: a walk in noise, with what `kind` says."""
    rng = np.random.default_rng(5)
    z, elapsed = np.cumsum(0.1 * rng.normal(size=ROWS)) + rng.normal(size=ROWS), even(ROWS)
    if kind == "holes":
        z[rng.random(ROWS) < 0.01], z[1010:1100], z[3000:4200] = np.nan, np.nan, np.inf
    elif kind == "gaps":
        elapsed[[700, 1024, 2048, 5000]] = 3.0, 2.0, 40.0, 7.0
    elif kind == "stamps":
        elapsed[1:] = rng.exponential(size=ROWS - 1)
    elif kind == "late":
        z[:2500] = np.nan
    elif kind == "one early":
        z[1:2500] = np.nan
    return z, elapsed


def flow(  # noqa: PLR0913  (a record, a filter, and how it is cut)
    order: int, density: float, readings: tuple[Floats, Floats], causal: bool, cuts: list[int], gate: Gate | None = None
) -> tuple[Floats, Floats, Flow]:
    shown: list[Floats] = []
    part = motion(order, density)
    made = Flow(part, 1.0, causal=causal, judge=lambda nu, sigma: shown.append(nu / sigma), gate=gate)
    z, elapsed = readings
    told = []
    for start, stop in zip([0, *cuts], [*cuts, len(z)], strict=True):
        told += made.push(z[start:stop], elapsed[start:stop])
    told += made.finish()
    assert sum(map(len, shown)) == len(z)
    return np.concatenate([part.signal for part in told]), np.concatenate([part.sigma for part in told]), made


KINDS = ["none", "holes", "gaps", "stamps", "late", "one early"]
CUTS = {"blocks": [1024, 2048, 3072, 4096, 5120], "odd": [1, 2, 5, 1000, 1001, 4000], "empty": [0, 2000, 2000]}


@pytest.mark.parametrize("cuts", CUTS.values(), ids=CUTS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("causal", [True, False])
def test_stretches_are_the_whole(kind: str, causal: bool, cuts: list[int]) -> None:
    z, elapsed = record(kind)
    part = motion(2, 1e-4)
    line = elapsed_timeline(part, 1.0, elapsed)
    model = part.to_model(1.0, 1.0)
    whole = run_filter(model, line, z[:, np.newaxis]).estimate
    expected = whole if causal else run_smoother(model, line, z[:, np.newaxis])
    signal, sigma, made = flow(2, 1e-4, (z, elapsed), causal, cuts)
    assert np.array_equal(np.isnan(signal), np.isnan(expected.signal[:, 0]))
    np.testing.assert_allclose(signal, expected.signal[:, 0], rtol=EQUAL, atol=EQUAL)
    np.testing.assert_allclose(sigma, expected.sigma[:, 0], rtol=EQUAL)
    assert made.log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-12)
    assert made.rows == ROWS


def test_cut_at_blocks_a_causal_flow_has_the_bits_of_the_whole() -> None:
    readings = record("none")
    signal, sigma, made = flow(2, 1e-2, readings, True, CUTS["blocks"])
    whole_signal, whole_sigma, whole = flow(2, 1e-2, readings, True, [])
    assert np.array_equal(signal, whole_signal)
    assert np.array_equal(sigma, whole_sigma)
    assert made.settled_row == whole.settled_row
    assert whole.settled_row is not None


def spoilt(kind: str) -> tuple[Floats, Floats]:
    """A record whose row before the first cut is not complete, or the last of its start; later ones are missing too."""
    z, elapsed = record("none")
    if kind == "missing":
        z[1023] = np.nan
    elif kind == "spike":
        z[1023] += 60.0
    elif kind == "opening":
        z[:1022] = np.nan  # two readings tell a motion of order 2
    z[[1173, 1223]] = np.nan  # so that the gain settles row by row
    return z, elapsed


@pytest.mark.parametrize("kind", ["missing", "spike", "opening"])
def test_a_cut_after_an_incomplete_row_keeps_the_bits(kind: str) -> None:
    """A gain settles after so many complete rows; one that comes before a cut and is not complete is none of them."""
    for density in (1e-3, 1e-2, 0.1, 1.0, 10.0):
        cut, whole = (flow(2, density, spoilt(kind), True, cuts, Gate(5.0)) for cuts in ([1024], []))
        assert np.array_equal(cut[0], whole[0], equal_nan=True)
        assert np.array_equal(cut[1], whole[1])
        assert cut[2].settled_row == whole[2].settled_row


@pytest.mark.parametrize("causal", [True, False])
def test_a_large_offset_costs_no_digits(causal: bool) -> None:
    """What moves keeps the digits that it has beside the offset in the readings themselves."""
    z, elapsed = record("none")
    z = np.round(z * 2.0**20) / 2.0**20  # so that the offset itself rounds nothing
    near = flow(5, 1e-9, (z, elapsed), causal, [])[0]
    far = flow(5, 1e-9, (z + 2.0**20, elapsed), causal, [])[0]
    np.testing.assert_allclose(far - 2.0**20, near, rtol=0, atol=2.0**-31)


def test_a_smoother_tells_as_soon_as_the_future_is_forgotten() -> None:
    z, elapsed = record("none")
    made = Flow(motion(1, 1.0), 1.0, causal=False)
    assert made.push(z[:1024], elapsed[:1024]) == []
    assert [len(part.signal) for part in made.push(z[1024:2048], elapsed[1024:2048])] == [1024]
    assert [len(part.signal) for part in made.finish()] == [1024]


def test_a_smoother_that_never_forgets_waits_for_all() -> None:
    z, elapsed = record("none")
    made = Flow(motion(2, 0.0), 1.0, causal=False)
    for start in range(0, ROWS, 1000):
        assert made.push(z[start : start + 1000], elapsed[start : start + 1000]) == []
    signal = np.concatenate([part.signal for part in made.finish()])
    line = np.polynomial.Polynomial.fit(np.arange(ROWS), z, 1)(np.arange(ROWS))
    np.testing.assert_allclose(signal, line, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("causal", [True, False])
def test_a_channel_in_which_nothing_arrives_stays_untold(causal: bool) -> None:
    z, elapsed = np.full(1000, np.nan), even(1000)
    signal, sigma, _ = flow(2, 1e-2, (z, elapsed), causal, [256, 512])
    assert np.isnan(signal).all()
    assert np.isinf(sigma).all()
