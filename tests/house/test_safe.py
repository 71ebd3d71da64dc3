"""The yardstick of safety can fail: it passes an estimate that is the truth, and names what is broken in another."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hidden_blocks import best_of, hidden_rows, rivals
from safe import OF_THE_SENSOR, is_seen, kept, tasks
from safe_bounds import (
    LIMITS,
    Estimate,
    away_rows,
    bridge,
    coverage_excess,
    largest_error,
    measures,
    ranges,
    rival,
    runs_of,
)
from safe_fuzz import drawn
from safe_insults import INSULTS, gaps, repeated, resolution, shock, spike, wild_ends
from safe_report import Result, page
from safe_signals import SIGNALS, Floats, Record, undamaged


def record_of(name: str = "walk", rows: int = 2000) -> Record:
    record = undamaged(SIGNALS[name], np.random.default_rng(3), rows)
    assert record is not None
    return record


def good_estimate(record: Record, size: float = 0.01) -> Estimate:
    """Return the truth with a small error whose sigma is told."""
    error = size * np.random.default_rng(4).normal(size=len(record.truth))
    return Estimate(record.truth + error, np.full(len(error), size), np.zeros(len(error), bool))


def small_error(record: Record, size: float = 0.01) -> Floats:
    return size * np.random.default_rng(5).normal(size=len(record.truth))


@pytest.mark.parametrize("insult", INSULTS)
@pytest.mark.parametrize("kind", ["smoothed", "causal"])
def test_an_estimate_near_the_truth_breaks_no_bound(insult: str, kind: str) -> None:
    damaged = INSULTS[insult](record_of(), np.random.default_rng(1))
    found = measures(good_estimate(damaged), small_error(damaged), damaged, kind)
    assert [bound for bound in LIMITS if found.get(bound, 0.0) > LIMITS[bound]] == []
    assert found["largest error"] < 0.2


def broken(found: dict[str, float]) -> set[str]:
    return {bound for bound in LIMITS if found.get(bound, 0.0) > LIMITS[bound]}


def test_each_bound_sees_its_own_fault() -> None:
    damaged = gaps(record_of(), np.random.default_rng(1), length=40)
    good, sound = good_estimate(damaged), small_error(damaged)
    hole = int(runs_of(damaged.hidden)[0][0]) + 20
    far = int(np.flatnonzero(away_rows(damaged))[5])

    runaway = good.signal.copy()
    runaway[hole] += 1.5 * ranges(damaged)[hole]
    assert broken(measures(good._replace(signal=runaway), sound, damaged, "smoothed")) == {"largest error", "inside"}

    noisy = damaged.truth + np.where(away_rows(damaged), 2.0, 1.0) * (good.signal - damaged.truth)
    assert "away" in broken(measures(good._replace(signal=noisy), sound, damaged, "smoothed"))

    lost = good.signal.copy()
    lost[far] = np.nan
    assert broken(measures(good._replace(signal=lost), sound, damaged, "smoothed")) == {"lost"}

    proud = good._replace(sigma=0.1 * good.sigma)
    assert broken(measures(proud, sound, damaged, "smoothed")) == {"near", "elsewhere"}
    timid = good._replace(sigma=10 * good.sigma)
    assert broken(measures(timid, sound, damaged, "smoothed")) == {"near", "elsewhere"}

    blind = np.where(damaged.hidden, np.nan, good.signal)
    found = measures(good._replace(signal=blind), sound, damaged, "smoothed")
    assert broken(found) == set()
    assert found["NaN inside"] == 1.0


def test_readings_of_a_shock_that_are_called_spikes_are_counted() -> None:
    moved = shock(record_of(), np.random.default_rng(1))
    good, sound = good_estimate(moved), small_error(moved)
    called = good._replace(spikes=moved.truth - record_of().truth > 5)
    assert measures(called, sound, moved, "smoothed")["cut off"] == np.count_nonzero(called.spikes) > 5
    hit = spike(record_of(), np.random.default_rng(1), size=1e3)
    assert measures(good_estimate(hit)._replace(spikes=hit.touched), sound, hit, "smoothed")["cut off"] == 0


def test_a_range_is_of_undamaged_readings_so_that_a_spike_widens_none() -> None:
    record = record_of()
    hit = wild_ends(record, np.random.default_rng(1))
    assert np.array_equal(ranges(hit)[200:], ranges(record)[200:])
    assert largest_error(hit.readings, hit) > 1000
    coarse = resolution(record, np.random.default_rng(1), sigmas=10)
    assert ranges(coarse) == pytest.approx(ranges(record) + 0.5)
    assert largest_error(np.where(np.arange(len(record.truth)) == 3, np.inf, record.truth), record) == np.inf


def test_a_line_joins_what_is_on_both_sides_and_a_hold_what_was_before() -> None:
    ramp = np.arange(100.0)
    hidden = (ramp >= 40) & (ramp < 60)
    record = record_of(rows=100)._replace(truth=ramp, sound=ramp, readings=ramp, hidden=hidden, touched=hidden)
    assert bridge(record, hidden, 1, None)[40:60] == pytest.approx(ramp[40:60])
    assert bridge(record, hidden, 16, None)[40:60] == pytest.approx(ramp[40:60])
    assert bridge(record, hidden, 1, 0)[40:60] == pytest.approx(np.full(20, 39.0))
    assert bridge(record, hidden, 4, 10)[[40, 59]] == pytest.approx([37.5, 59.0])
    opening = ramp < 20
    assert bridge(record, opening, 1, None)[:20] == pytest.approx(np.full(20, 20.0))
    assert np.isnan(bridge(record, opening, 1, 0)).all()
    assert np.isnan(bridge(record, hidden, 1, None)[~hidden]).all()


@pytest.mark.parametrize(("name", "length", "is_line"), [("slow drift", 40, True), ("band 30 Hz", 200, False)])
def test_the_rival_is_a_line_where_that_is_better_and_the_mean_elsewhere(name: str, length: int, is_line: bool) -> None:
    damaged = gaps(record_of(name, 6000), np.random.default_rng(1), length=length)
    found, usual = rival(damaged, None)
    assert 0 < usual < 1.5
    assert (np.ptp(found[damaged.hidden]) > 0) == is_line
    assert not np.isnan(found[damaged.hidden]).any()


def test_coverage_is_wrong_only_beyond_chance() -> None:
    rng = np.random.default_rng(7)
    error, truth, rows = rng.normal(size=2000), np.zeros(2000), np.ones(2000, bool)
    of = partial(Estimate, error, spikes=np.zeros(2000, bool))
    assert coverage_excess(of(np.ones(2000)), truth, rows) == 0
    assert coverage_excess(of(np.full(2000, 0.3)), truth, rows) > 0.2
    assert np.isnan(coverage_excess(of(np.ones(2000)), truth, rows & (np.arange(2000) < 30)))
    slow = Estimate(np.full(2000, 0.5), np.ones(2000), rows)
    assert coverage_excess(slow, truth, rows) == 0, "one run of one sign says nothing"


def test_a_slower_sensor_is_judged_in_the_rows_of_its_readings() -> None:
    slow = repeated(record_of(), np.random.default_rng(1), every=4)
    assert np.flatnonzero(away_rows(slow))[:3].tolist() == [0, 4, 8]
    assert np.array_equal(slow.readings[:8], np.repeat(slow.sound[[0, 4]], 4))


def test_insults_are_the_same_every_time_and_random_records_too() -> None:
    for insult in INSULTS.values():
        one, two = (insult(record_of(), np.random.default_rng(9)) for _ in range(2))
        assert np.array_equal(one.readings, two.readings, equal_nan=True)
    (first, what), (again, _) = drawn(5), drawn(5)
    assert np.array_equal(first.readings, again.readings, equal_nan=True)
    assert len({drawn(seed)[1] for seed in range(20)}) == 20
    assert "rows" in what


def test_a_page_counts_what_is_beyond_and_names_the_worst_first() -> None:
    cases = [
        Result("walk", "gap 40", "smoothed", "file", {"largest error": 3.0, "away": 1.2}, ""),
        Result("walk", "shock", "smoothed", "file", {"largest error": 70.0, "away": np.nan}, ""),
        Result("saw", "shock", "smoothed", "file", {"raised": 1.0}, "ValueError: no"),
    ]
    text = page(cases, every=False)
    assert "| largest error | 1 | 2 | 2 | 100.0% | 36.5 | 70 |" in text
    assert "| away, in 95 % | 1.1 | 1 | 1 |" in text
    assert text.index("- 70: walk, shock") < text.index("- 3: walk, gap 40")
    assert "- 1: saw, shock, smoothed, file: ValueError: no" in text


def test_a_stream_meets_no_insult_of_the_sensor_itself() -> None:
    assert all(
        not one.startswith(OF_THE_SENSOR) for task in tasks(["walk"], list(INSULTS), ["live"]) for one in task[3]
    )


def test_kept_results_are_not_run_again(tmp_path: Path) -> None:
    done, keep = tasks(["walk"], ["shock"], ["live"]), tmp_path / "kept.jsonl"
    results = [Result("walk", "shock", task.estimate, "live", {"away": np.nan, "lost": 0.0}, "") for task in done]
    keep.write_text("".join(f"{json.dumps(one)}\n" for one in results), encoding="utf-8")
    found = kept(done, 1, keep)
    assert [one.name for one in found] == [one.name for one in results]
    assert np.isnan(found[0].measured["away"])


def test_a_sensor_that_is_too_slow_for_its_signal_is_left_out() -> None:
    rng = np.random.default_rng(1)
    assert is_seen(record_of("band 30 Hz"))
    assert not is_seen(INSULTS["every tenth"](record_of("band 30 Hz"), rng))
    assert is_seen(INSULTS["every tenth"](record_of("slow drift"), rng))


def test_blocks_are_hidden_among_readings_that_are_there() -> None:
    z = np.where(np.arange(6000) < 5000, np.nan, 1.0)
    hidden = hidden_rows(z, 40, np.random.default_rng(1))
    assert hidden.any()
    assert np.isfinite(z[hidden]).all()


def test_the_best_butterworth_knows_what_is_hidden() -> None:
    t = np.arange(3000) / 100.0
    z = np.sin(2 * np.pi * t)
    hidden = hidden_rows(z, 8, np.random.default_rng(1))
    assert 0.04 < hidden.mean() < 0.06
    assert not hidden[[0, -1]].any()
    error, whose = best_of(rivals(z, hidden), np.ones(hidden.sum(), bool))
    line = np.interp(t, t[~hidden], z[~hidden])
    assert error <= np.sqrt(np.mean((line - z)[hidden] ** 2))
    assert whose.startswith(("line", "Butterworth"))
