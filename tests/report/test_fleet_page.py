"""The report on a fleet: the worst first in any order of any rows, and the page holds what was put in, as text."""

from __future__ import annotations

import base64
import gzip
import json
import math
import re
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import becalm
from becalm.cleaning.channels.faults import Fault
from becalm.cleaning.channels.judging import Decision
from becalm.core.reading_verdicts import Verdict
from becalm.report.fleet.fleet_order import TRAITS, badness, summary, usual_noise, worst_first
from becalm.report.fleet.fleet_page import FleetFacts, fleet_page
from becalm.report.fleet.fleet_rows import LOSSES, FleetRow, faults_text, row_of
from fleet_report import simulated

FACTS = FleetFacts("lake", "cleaned", "2026-03-01T06:00:00+00:00", 5025.0, 12_345_678, ("default",))
FINE = FleetRow("s", "a", "V", verdict="fits", health=1.0, noise_std=0.1, usable_share=1.0, rows=100, rate_hz=10.0)
HOSTILE = [
    "</script><script>window.ran = 1</script>",
    '<img src=x onerror="window.ran = 1">',
    "\"quoted\" 'name' &amp; {{ 7 * 7 }}",
    "Halle=Süd/加速度=३",
    "folder=\udcff",  # no UTF-8, as an operating system may name it
    "a" * 300,
]
ORDERED = [
    replace(FINE, sensor="2", state="refused", reason="It has no row.", verdict="", health=None, noise_std=None),
    replace(FINE, sensor="10", state="refused", reason="It has no row.", verdict="", health=None, noise_std=None),
    replace(FINE, sensor="3", verdict="does not fit", health=9.0),
    replace(FINE, sensor="1", verdict="does not fit", health=0.5),
    replace(FINE, sensor="0", verdict="does not fit", health=math.nan),
    replace(FINE, sensor="8", faults="70 stuck, 1 gap", usable_share=0.3),
    replace(FINE, sensor="7", faults="1 clipped", usable_share=0.99),
    replace(FINE, sensor="6", faults="9 dead", usable_share=None),
    replace(FINE, sensor="5", outlying="Its noise is another.", noise_std=0.01),
    replace(FINE, sensor="4", outlying="Its noise is another.", noise_std=0.5),
    replace(FINE, sensor="1", outlying="It lags.", noise_std=None),
    replace(FINE, sensor="9", verdict="untold", health=None, usable_share=0.1),
    replace(FINE, sensor="8", verdict="constant", health=None),
    replace(FINE, sensor="b1", verdict="fits except", health=1.2),
    replace(FINE, sensor="a1", verdict="fits except", health=1.0),
    replace(FINE, sensor="b2", health=0.1),
    replace(FINE, sensor="a2", health=4.0),
    replace(FINE, sensor="z", noise_std=0.12, faults="3 spikes, 2 gaps"),
    replace(FINE, sensor="y", noise_std=0.08),
    replace(FINE, sensor="x", noise_std=None),
]
"""The worst first, as `badness` describes it; sensors of the median noise would come between z and y."""

numbers = st.none() | st.floats(min_value=0) | st.just(math.nan) | st.just(-1.0)
rows_of_any = st.lists(
    st.builds(
        FleetRow,
        st.sampled_from(["a", "b=2", "b=10", "b=010", "9" * 5000]),
        st.sampled_from(["", "x"]),
        state=st.sampled_from(["cleaned", "kept", "refused"]),
        verdict=st.sampled_from(["", *get_args(Decision)]),
        health=numbers,
        noise_std=numbers,
        usable_share=st.none() | st.floats(0, 1) | st.just(math.nan),
        faults=st.sampled_from(["", "1 clipped", "2 gaps"]),
        outlying=st.sampled_from(["", "It is unlike."]),
    ),
    max_size=12,
)


def held_in(html: str) -> dict[str, Any]:
    """Read what a page holds, as its script does."""
    found = re.search(r'<script type="application/octet-stream" id="rows">(.*?)</script>', html)
    assert found is not None
    held: dict[str, Any] = json.loads(gzip.decompress(base64.b64decode(found[1])), parse_constant=_refuse)
    return held


def _refuse(word: str) -> None:
    raise AssertionError(f"{word} is no JSON")


@pytest.mark.parametrize("seed", range(5))
def test_the_worst_come_first(seed: int) -> None:
    places = np.random.default_rng(seed).permutation(len(ORDERED))
    assert worst_first([ORDERED[place] for place in places]) == ORDERED


@given(rows=rows_of_any, data=st.data())
def test_any_rows_have_one_order(rows: list[FleetRow], data: st.DataObject) -> None:
    told = worst_first(rows)
    usual = usual_noise(rows)
    found = [badness(row, usual.get((row.channel, row.unit), math.nan)) for row in told]
    assert found == sorted(found)
    assert not any(math.isnan(goodness) for _, goodness in found)
    again = worst_first(data.draw(st.permutations(rows)))
    names = [(row.sensor, row.channel) for row in rows]
    if len(set(names)) == len(names):  # which alone tells apart what is equally bad
        assert [id(row) for row in again] == [id(row) for row in told]


@given(rows=rows_of_any)
def test_something_is_true_of_every_row_and_kept_is_never_all(rows: list[FleetRow]) -> None:
    for row in rows:
        assert any(trait.holds(row) for trait in TRAITS if trait.name != "kept")


def test_faults_are_told_in_words_and_the_grave_ones_make_faulty() -> None:
    faults = [Fault(what, count, 1, 0.0, 0.0) for what, count in (("spike", 1), ("clipped", 1203), ("gap", 2))]
    assert faults_text(faults) == "1 203 clipped, 1 spike, 2 gaps"
    faulty = next(trait for trait in TRAITS if trait.name == "faulty")
    for verdict in Verdict:
        what = verdict.name.lower()
        row = replace(FINE, faults=faults_text([Fault(what, 1, 1, 0.0, 0.0)]))
        assert faulty.holds(row) == (what in LOSSES), what


def test_a_row_tells_what_was_found() -> None:
    z = np.random.default_rng(2).normal(5.0, 0.1, 4000)
    z[:1000] = np.nan
    cleaned = becalm.clean(becalm.Recording(z, names=["a"], units=["V"], rate_hz=100.0))
    (report,) = cleaned.reports
    row = row_of("sensor=1", report, recipe="0123456789ab", rate_hz=100.0)
    assert (row.sensor, row.channel, row.unit, row.recipe, row.rate_hz) == ("sensor=1", "a", "V", "0123456789ab", 100.0)
    assert (row.rows, row.usable_share) == (4000, 0.75)
    assert (row.verdict, row.health, row.noise_std, row.says) == (
        report.verdict,
        report.nis_mean,
        report.noise_std,
        report.says,
    )
    assert row.noise_std == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([], "There is no sensor."),
        ([FINE], "1 of 1 sensor is cleaned."),
        ([replace(FINE, state="refused")], "0 of 1 sensor is cleaned; 1 is refused."),
        ([FINE, replace(FINE, channel="b", verdict="does not fit")], "1 of 1 sensor is cleaned (1 does not fit)."),
        (
            [replace(FINE, sensor=str(k), state="kept" if k % 2 else "cleaned") for k in range(10_000)],
            "10 000 of 10 000 sensors are cleaned (5 000 were finished before).",
        ),
        (
            [
                FINE,
                replace(FINE, channel="b", outlying="It is unlike."),
                replace(FINE, sensor="t", verdict="does not fit", faults="3 dead"),
                replace(FINE, sensor="u", verdict="does not fit"),
                replace(FINE, sensor="v", state="refused", verdict=""),
                replace(FINE, sensor="w", verdict="does not fit"),
                replace(FINE, sensor="w", channel="b", state="refused", verdict=""),
            ],
            "3 of 5 sensors are cleaned (2 do not fit, 1 is faulty, 1 is outlying); 2 are refused.",
        ),
    ],
)
def test_a_fleet_is_told_in_a_sentence(rows: list[FleetRow], says: str) -> None:
    assert summary(rows) == says
    assert summary(rows, "tuned") == says.replace("cleaned", "tuned")


def test_a_page_holds_what_was_put_in() -> None:
    rows = simulated(300)
    html = fleet_page(rows, FACTS)
    held, told = held_in(html), worst_first(rows)
    for name in ("sensor", "channel", "unit", "reason", "faults", "says", "recipe", "outlying", "rows"):
        assert held["columns"][name] == [getattr(row, name) for row in told]
    for name in ("health", "noise_std", "rate_hz"):
        expected = [getattr(row, name) for row in told]
        assert [one is None for one in held["columns"][name]] == [one is None for one in expected]
        known = [(one, other) for one, other in zip(held["columns"][name], expected, strict=True) if other is not None]
        assert all(one == pytest.approx(other, rel=1e-5) for one, other in known)
    names = [trait["name"] for trait in held["traits"]]
    assert names == [trait.name for trait in TRAITS]
    for row, bits in zip(told, held["columns"]["traits"], strict=True):
        assert [bool(bits & 1 << bit) for bit in range(len(TRAITS))] == [trait.holds(row) for trait in TRAITS]
    for told_in_words in ("2026-03-01 06:00 UTC", "1 h 23 min", "12\u202f345\u202f678", "cleaned", "default"):
        assert told_in_words in html
    assert summary(rows) in html.replace("\u202f", " ")


def test_the_same_fleet_gives_the_same_bytes() -> None:
    rows = simulated(40)
    assert fleet_page(rows[::-1], FACTS) == fleet_page(rows, FACTS)


@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf])
def test_what_is_unknown_is_null(value: float | None) -> None:
    row = FleetRow("s", health=value, noise_std=value, usable_share=value, rate_hz=value)
    columns = held_in(fleet_page([row], FleetFacts("", "", "yesterday")))["columns"]
    assert [columns[name] for name in ("health", "noise_std", "usable", "rate_hz")] == [[None]] * 4


def test_all_is_told_as_all_only_where_it_is() -> None:
    shares = [1.0, 1 - 1e-9, 0.57, 0.0]
    columns = held_in(fleet_page([replace(FINE, usable_share=share) for share in shares], FACTS))["columns"]
    assert sorted(columns["usable"]) == [0, 57, 99.99, 100]


def test_names_are_text_and_nothing_else() -> None:
    rows = [replace(FINE, sensor=name, channel=name, says=name, outlying=name, recipe=name) for name in HOSTILE]
    html = fleet_page(rows, FleetFacts(HOSTILE[1], HOSTILE[0], HOSTILE[2], recipes=tuple(HOSTILE)))
    html.encode()  # whatever folders are called
    assert html.count("<script") == 2
    assert "<img" not in html
    assert "49" not in re.findall(r"<dd>.*?</dd>", html)[1]
    assert set(held_in(html)["columns"]["sensor"]) == set(HOSTILE)


def test_nothing_is_asked_of_the_network() -> None:
    html = fleet_page([FINE], FACTS)
    assert not re.search(r"\s(?:src|href|action|data|srcset|poster|background)=", html)
    assert not re.search(r"@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon|\bimport\(|https?:", html)
    assert not re.search(r"^import ", html, re.MULTILINE), "a page on a disk can import nothing"
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', html)
    assert "default-src 'none'" in policy
    assert "http" not in policy
