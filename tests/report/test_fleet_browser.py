"""The report on a fleet in a browser that is offline: every row is there, found, put in order, and opened."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from becalm.report.fleet.fleet_order import TRAITS
from becalm.report.fleet.fleet_page import FleetFacts
from becalm.report.fleet.fleet_rows import FleetRow
from browsing import settle
from fleets import FINE, OpenFleet, browser, choose, fleet, open_fleet, search, shown, traits_of

if TYPE_CHECKING:
    pass

MOST_HELD = 120  # rows in the page at once, whatever the fleet
LINES = "() => [...document.querySelectorAll('#table tbody [aria-expanded]')].map((one) => one.innerText.split('\\n'))"

pytestmark = pytest.mark.slow
__all__ = ["browser", "open_fleet"]


def test_every_row_is_there_and_few_are_in_the_page(open_fleet: OpenFleet) -> None:
    page = open_fleet(fleet()).page
    assert page.locator("#table").get_attribute("aria-rowcount") == str(len(fleet()) + 1)
    seen: dict[int, list[str]] = {}
    for _ in range(200):
        seen |= {int(cells[0]): cells for cells in page.evaluate(LINES)}
        assert page.locator("#table tbody tr").count() < MOST_HELD
        at = page.evaluate("() => { scrollBy(0, 500); return scrollY + innerHeight; }")
        settle(page)
        if at >= page.evaluate("() => document.documentElement.scrollHeight") - 1:
            break
    seen |= {int(cells[0]): cells for cells in page.evaluate(LINES)}
    assert sorted(seen) == list(range(1, len(fleet()) + 1))
    for number, cells in seen.items():
        row = fleet()[number - 1]
        assert cells[1] == row.sensor
        assert row.channel in cells
        assert ", ".join(traits_of(row)) in cells
        assert not row.faults or row.faults in cells
        if row.noise_std is not None:
            assert any(cell == f"{float(f'{row.noise_std:.3g}'):g} {row.unit}" for cell in cells), cells


def test_a_filter_shows_only_these(open_fleet: OpenFleet) -> None:
    page = open_fleet(fleet()).page
    for trait in TRAITS:
        expected = [row for row in fleet() if trait.holds(row)]
        button = page.locator(f".filters button[title='{trait.says}']")
        button.click()
        assert button.inner_text() == f"{trait.name} {len(expected)}"
        assert button.get_attribute("aria-pressed") == "true"
        assert shown(page) == expected
        assert page.locator("#shown").inner_text() == f"{len(expected)} of {len(fleet())}"
    button.click()
    assert shown(page) == fleet(), "a second press shows all again"
    assert page.locator(".filters button[aria-pressed='true']").inner_text().startswith("all")


def test_a_search_finds_every_word(open_fleet: OpenFleet) -> None:
    page = open_fleet(fleet()).page
    texts = [
        f"{row.sensor} {row.channel} {row.recipe} {row.faults} {row.outlying} {row.reason} {row.says}".lower()
        for row in fleet()
    ]
    for asked in ("sensor=00017", "PLANT=3 strain", "clipped", "predictable", "c0ffee01", "no such sensor", ""):
        search(page, asked)
        words = asked.lower().split()
        found = [row for row, text in zip(fleet(), texts, strict=True) if all(word in text for word in words)]
        assert shown(page) == found
    choose(page, "faulty")
    search(page, "strain")
    assert {row.channel for row in shown(page)} == {"strain"}
    assert all("faulty" in traits_of(row) for row in shown(page))


@pytest.mark.parametrize(
    ("heading", "key", "down"),
    [
        ("sensor", lambda row: tuple(int(part.split("=")[1]) for part in row.sensor.split("/")), False),
        ("channel", lambda row: row.channel or None, False),
        ("noise", lambda row: row.noise_std and float(f"{row.noise_std:.6g}"), True),
        ("NIS", lambda row: row.health and float(f"{row.health:.6g}"), True),
        ("usable", lambda row: row.usable_share and math.floor(row.usable_share * 1e4 + 1e-9), False),
        ("faults", lambda row: row.faults or None, False),
        ("rows", lambda row: row.rows, True),
    ],
)
def test_a_heading_orders_by_its_column(
    heading: str, key: Callable[[FleetRow], Any], down: bool, open_fleet: OpenFleet
) -> None:
    page = open_fleet(fleet()).page
    unknown = [row for row in fleet() if key(row) is None]
    known = [row for row in fleet() if key(row) is not None]
    button = page.locator(f"th button:text-is('{heading}')")
    for downward in (down, not down):
        button.click()
        assert button.locator("..").get_attribute("aria-sort") == ("descending" if downward else "ascending")
        assert shown(page) == [*sorted(known, key=key, reverse=downward), *unknown], "unknown last, equal worst first"
    page.locator("th button:text-is('#')").click()
    assert shown(page) == fleet()


def test_a_row_opens_with_all_that_is_known_of_it(open_fleet: OpenFleet) -> None:
    page = open_fleet(fleet()).page
    for trait in TRAITS:
        row = next(row for row in fleet() if trait.holds(row))
        search(page, f"{row.sensor} {row.channel}")
        line = page.locator("#table tbody [aria-expanded]").first
        line.click()
        assert page.locator("[aria-expanded='true']").count() == 1
        text = page.locator(".opened").inner_text()
        for words in (row.sensor, row.channel, row.reason, row.says, row.outlying, row.faults, row.recipe):
            assert words in text
        line.click()
        assert page.locator(".opened").count() == 0


def test_rows_keep_their_places_below_an_open_one(open_fleet: OpenFleet) -> None:
    page = open_fleet(fleet()).page
    height_of = "(name) => document.querySelector(name).getBoundingClientRect().height"
    height = page.evaluate(height_of, "#table")
    page.locator("#table tbody [aria-expanded]").nth(3).click()
    room = page.evaluate(height_of, ".opened")
    assert room > 50
    for y in (0, 300, 5_000, 1e6, 4_000, 0):
        page.evaluate("(y) => scrollTo(0, y)", y)
        settle(page)
        assert page.evaluate(height_of, "#table") == pytest.approx(height + room, abs=0.1)
        tops = page.evaluate(
            "() => [...document.querySelectorAll('#table tbody [aria-expanded]')].map((one) =>"
            " [one.ariaRowIndex - 2, one.getBoundingClientRect().top - one.parentElement.getBoundingClientRect().top])"
        )
        for at, top in tops:
            assert top == pytest.approx(32 * at + (room if at > 3 else 0), abs=0.1)
    page.locator("#table tbody [aria-expanded]").nth(3).click()
    assert page.evaluate(height_of, "#table") == height


def test_the_keyboard_reaches_all(open_fleet: OpenFleet) -> None:
    page = open_fleet(fleet()).page
    reached: list[str] = []
    for _ in range(60):
        page.keyboard.press("Tab")
        found = page.evaluate(
            "() => { const one = document.activeElement; return [one.id || one.innerText, one.tagName,"
            " getComputedStyle(one.querySelector('.current') ?? one).outlineStyle]; }"
        )
        if found[1] == "BODY":
            break
        assert found[2] != "none", "what has the focus is seen"
        reached.append(found[0])
    assert len(reached) == len(set(reached))
    assert {"search", "table", "noise", "NIS"} <= set(reached)
    assert any(one.startswith("does not fit") for one in reached)
    page.locator("#table").focus()
    active = "() => document.getElementById(document.querySelector('#table').getAttribute('aria-activedescendant'))"
    last = len(fleet()) - 1
    for key, at in (("ArrowDown", 1), ("PageDown", 11), ("ArrowUp", 10), ("End", last), ("ArrowDown", last)):
        page.keyboard.press(key)
        assert page.evaluate(f"({active})().ariaRowIndex - 2") == at
        box = page.evaluate(f"(({active})().getBoundingClientRect().toJSON())")
        assert box["top"] >= 0
        assert box["bottom"] <= 900
    page.keyboard.press("Enter")
    assert fleet()[-1].sensor in page.locator(".opened").inner_text()
    box = page.locator(".opened").bounding_box()
    assert box is not None
    assert box["y"] + box["height"] <= 901, "what was opened is in sight"
    page.keyboard.press("Home")
    page.keyboard.press(" ")
    assert fleet()[0].sensor in page.locator(".opened").inner_text()


def test_hostile_names_are_text_and_run_nothing(open_fleet: OpenFleet) -> None:
    names = [
        "</script><script>window.ran = 1</script>",
        '"><img src=x onerror="window.ran = 1">',
        "Halle=Süd/加速度=३",
        "folder=\udcff",
        "مصنع=1/sensor=17",
        "a" * 3000,
    ]
    rows = [replace(FINE, sensor=name, channel=name, says=name, outlying=name, reason=name) for name in names]
    page = open_fleet(rows, FleetFacts(names[1], names[0], recipes=tuple(names))).page
    assert page.locator("h1").inner_text() == names[1]
    told = {cells[1] for cells in page.evaluate(LINES)}
    assert told == set(names)
    for place in range(len(names)):
        page.locator("#table tbody [aria-expanded]").nth(place).click()
    assert page.evaluate("() => window.ran === undefined")
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 1300
    assert page.locator("img").count() == 0


@pytest.mark.parametrize(
    "rows",
    [
        [],
        [FINE],
        [FleetRow("s")] * 3,
        [replace(FINE, noise_std=value, health=value, rate_hz=value) for value in (0.0, math.nan, math.inf, 1e-300)],
        [replace(FINE, noise_std=1e300), replace(FINE, noise_std=1e-300)],
        [replace(FINE, channel=f"c{k}") for k in range(20)],
    ],
    ids=["none", "one", "unknown", "far", "farther", "channels"],
)
def test_any_fleet_makes_a_page(rows: list[FleetRow], open_fleet: OpenFleet) -> None:
    page = open_fleet(rows).page
    assert len(page.evaluate(LINES)) == len(rows)
    for place in range(len(rows)):
        page.locator("#table tbody [aria-expanded]").nth(place).click()
    page.locator("#table").focus()
    for key in ("ArrowDown", "End", "Enter", "Home"):
        page.keyboard.press(key)
    for heading in page.locator("th button").all():
        heading.click()
    search(page, "nothing")
    assert page.evaluate(LINES) == []
