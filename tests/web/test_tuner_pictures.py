"""A filter over a part of a record gives the numbers of `clean`; what is drawn of it loses nothing."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest

import becalm
from becalm.cleaning.channels.excerpt import ChannelRows, ChannelRun
from becalm.cleaning.dial_positions import density_unit
from becalm.cleaning.pipeline import Cleaned
from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.cleaning.recipes.steps import lag_in_rows
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.core.rows import EstimatedRows
from becalm.web.tuner import picture
from becalm.web.tuner.picture import CleanCurve, View, clean_of, raw_of, view_of
from tuner_records import GATE, ROWS, Case, cases, even, motion, walk

CASES = cases()
OPENING = 20
PARTS = {
    "whole": (0, ROWS),
    "start": (0, 700),
    "middle": (14_900, 15_400),
    "after a long gap": (20_990, 21_300),
    "one row": (16_500, 16_501),
    "end": (ROWS - 300, ROWS),
}


@pytest.fixture
def pool() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as threads:
        yield threads


@cache
def cleaned(name: str) -> Cleaned:
    return becalm.clean(CASES[name].recording, CASES[name].recipe)


def rows_of(recording: Recording) -> ChannelRows:
    time = recording.timebase
    return ChannelRows(np.ascontiguousarray(recording.samples[:, 0]), time.elapsed_steps, time.step_s)


def lag_of(recipe: Recipe) -> int | None:
    if recipe.mode == "lagged":
        assert recipe.lag_s is not None
        return lag_in_rows(recipe.lag_s, 1 / recipe.tuned_on.rate_hz)
    return None if recipe.mode == "smoothed" else 0


def told(case: Case, first: int, stop: int) -> EstimatedRows:
    run = ChannelRun(rows_of(case.recording), case.recipe.channel[0], lag_of(case.recipe))
    parts = list(run.estimates_of(first, stop))
    return EstimatedRows(*(np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)))


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("name", CASES)
def test_a_part_has_the_numbers_of_the_whole(name: str, part: str) -> None:
    (first, stop), whole = PARTS[part], cleaned(name)
    found = told(CASES[name], first, stop)
    signal, sigma = whole.signal.samples[first:stop, 0], whole.sigma.samples[first:stop, 0]
    known = np.isfinite(sigma)
    rough = (np.arange(first, stop) < OPENING) & (name == "tones")  # `clean` itself has no more digits there
    near = np.where(rough, 1e-3, 1e-9)[known]
    np.testing.assert_array_equal(np.isfinite(found.sigma), known)
    np.testing.assert_array_equal(np.isnan(found.signal), np.isnan(signal))
    most = near * sigma[known]
    assert (np.abs(found.sigma[known] - sigma[known]) <= most).all()
    assert (np.abs(found.signal[known] - signal[known]) <= most).all()
    np.testing.assert_array_equal(found.verdicts, whole.verdicts["ax"][first:stop])


@pytest.mark.parametrize("name", ["order 2", "gaps, causal", "uneven", "gated", "tones", "limits", "switching, causal"])
def test_halves_side_by_side_are_one_picture(name: str, pool: Executor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "LONG", 1000)
    case, whole = CASES[name], cleaned(name)
    view = View(3, ROWS - 5, 777)
    found = clean_of(rows_of(case.recording), case.recipe.channel[0], lag_of(case.recipe), view, pool)
    signal, sigma = (one.samples[view.first : view.stop, 0] for one in (whole.signal, whole.sigma))
    same(found, signal, sigma, view)
    verdicts = whole.verdicts["ax"][view.first : view.stop]
    for code in Verdict:
        met = [
            bool((verdicts[at : at + view.rows_each] == code).any()) for at in range(0, len(verdicts), view.rows_each)
        ]
        np.testing.assert_array_equal((found.verdicts >> code) & 1, np.array(met) & (code != Verdict.USED))


def stretches(view: View) -> list[slice]:
    rows = view.stop - view.first
    return [slice(at, at + view.rows_each) for at in range(0, rows, view.rows_each)]


def same(found: CleanCurve, signal: Floats, sigma: Floats, view: View) -> None:
    half = 2 * np.where(np.isfinite(sigma), sigma, np.nan)
    scale = float(np.nanmin(half))
    for of, low, high in ((found.signal, signal, signal), (found.band, signal - half, signal + half)):
        for got, values, extreme in ((of.low, low, np.fmin), (of.high, high, np.fmax)):
            expected = [
                extreme.reduce(values[at : at + view.rows_each]) for at in range(0, len(values), view.rows_each)
            ]
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9 * scale)


def test_a_long_record_runs_in_two_halves(pool: Executor, monkeypatch: pytest.MonkeyPatch) -> None:
    z, taken, enclosed = walk(rows=1 << 20), list[View](), picture._filter_part

    def noting(run: ChannelRun, view: View, each: int) -> CleanCurve:
        taken.append(view)
        return enclosed(run, view, each)

    monkeypatch.setattr(picture, "_filter_part", noting)
    clean_of(rows_of(even(z)), motion(process_noise_density=0.3), None, View(0, len(z), 2000), pool)
    first, second = sorted(taken)
    assert (first.first, first.stop, second.stop) == (0, second.first, len(z))


@pytest.mark.parametrize("width", [1, 3, 50, 400, 4000])
@pytest.mark.parametrize("span_s", [(-1.0, 99.0), (9.0, 11.0), (9.999, 10.001), (10.0, 10.0)])
def test_a_spike_of_one_row_survives_every_zoom(width: int, span_s: tuple[float, float], pool: Executor) -> None:
    z = walk()
    z[10_000] = 150.0
    rows = rows_of(even(z))
    view = view_of(rows, None, span_s, width)
    assert view.first <= 10_000 < view.stop
    raw = raw_of(rows, None, view)
    assert len(raw.times_s) <= width
    stretch = (10_000 - view.first) // view.rows_each
    assert raw.readings.high[stretch] == 150.0
    assert raw.times_s[stretch] <= 10.0
    gated = motion(process_noise_density=0.3, gate=GATE)
    found = clean_of(rows, gated, None, view, pool)
    assert found.verdicts[stretch] & (1 << Verdict.SPIKE)
    np.testing.assert_array_equal(np.flatnonzero(found.verdicts & (1 << Verdict.SPIKE)), [stretch])
    assert found.signal.high[stretch] < 110.0
    if view.rows_each < 100:  # in longer stretches the wave is higher than what a spike leaves where it is believed
        believed = clean_of(rows, motion(process_noise_density=0.3), None, view, pool)
        assert believed.signal.high[stretch] > found.signal.high[stretch] + 0.5


def test_a_view_of_uneven_time_holds_what_it_spans() -> None:
    rows = rows_of(CASES["uneven"].recording)
    times = np.cumsum(rows.elapsed) * rows.step_s
    view = view_of(rows, lambda: times, (5.0, 6.0), 10)
    assert times[view.first] <= 5.0 < times[view.first + 1]
    assert times[view.stop - 2] < 6.0 <= times[view.stop - 1]
    outside = view_of(rows, lambda: times, (1e9, 2e9), 10)
    assert (outside.first, outside.stop) == (ROWS - 1, ROWS)


def test_impossible_readings_leave_room_for_the_others() -> None:
    z = walk()
    z[3], z[4] = np.inf, 1e150
    rows = rows_of(even(z))
    raw = raw_of(rows, None, View(0, 10, 10))
    assert np.isnan(raw.readings.high[[3, 4]]).all()
    assert np.isfinite(raw.readings.high[[2, 5]]).all()


def test_a_channel_that_passes_unchanged_is_shown_without_sigma(pool: Executor) -> None:
    rows = rows_of(even(walk()))
    unchanged = ChannelRecipe(name="ax", model="untold")
    found = clean_of(rows, unchanged, None, View(0, 100, 100), pool)
    np.testing.assert_array_equal(found.signal.low, rows.z[:100])
    assert np.isnan(found.band.low).all()


def test_a_part_begins_no_earlier_than_it_must() -> None:
    rows = rows_of(even(walk()))
    assert ChannelRun(rows, motion(process_noise_density=300.0), None).run_up_rows < 2000
    assert ChannelRun(rows, motion(process_noise_density=0.0), None).run_up_rows == ROWS


@pytest.mark.parametrize(
    ("unit", "order", "density"),
    [("m/s^2", 1, "(m/s^2)^2/s"), ("N", 2, "N^2/s^3"), ("s^2", 3, "(s^2)^2/s^5"), ("", 1, "1/s")],
)
def test_a_density_has_the_unit_of_its_order(unit: str, order: int, density: str) -> None:
    assert density_unit(unit, order) == density
