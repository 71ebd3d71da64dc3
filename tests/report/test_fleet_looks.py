"""What the report on a fleet looks like: its dots, the dark, narrow windows, paper; and how soon it is there."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import pytest

from becalm.report.fleet.fleet_page import fleet_page
from browsing import settle
from fleet_report import MOST_ANSWERS_MS, MOST_BYTES, MOST_OPENS_MS, facts_of, simulated, timed
from fleets import OpenFleet, browser, choose, fleet, open_fleet, search, shown

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow
__all__ = ["browser", "open_fleet"]


def test_a_dot_tells_its_sensor_and_finds_its_row(open_fleet: OpenFleet) -> None:
    opened = open_fleet(fleet())
    page = opened.page
    row = next(row for row in fleet() if row.outlying)
    choose(page, "refused")
    search(page, "nothing of this")
    at = page.evaluate(
        "(row) => { for (const [i, { canvas, dots, x, y }] of becalmFleet.strips.entries()) {"
        " const k = dots.findIndex((dot) => dot.row === row); const box = canvas.getBoundingClientRect();"
        " if (k >= 0) return [i + 1, box.left + x[k], box.top + y[k]]; } }",
        fleet().index(row),
    )
    strip = f"strip-{at[0]}"
    page.mouse.move(at[1], at[2])
    assert page.locator(f"#{strip} figcaption").inner_text().startswith(f"{row.sensor}: ")
    page.mouse.click(at[1], at[2])
    settle(page)
    assert row.outlying in page.locator(".opened").inner_text()
    assert page.locator("#search").input_value() == ""
    assert shown(page) == fleet()
    box = page.locator(".opened").bounding_box()
    assert box is not None
    assert box["y"] + box["height"] <= 901


def test_every_sensor_with_noise_is_drawn_and_the_outlying_ones_are_marked(open_fleet: OpenFleet) -> None:
    opened = open_fleet(fleet())
    dots = opened.page.evaluate("() => becalmFleet.strips.map(({ dots }) => dots.map(({ row }) => row))")
    assert sorted(place for strip in dots for place in strip) == [
        place for place, row in enumerate(fleet()) if row.noise_std
    ]
    marked = [[place for place in strip if fleet()[place].outlying] for strip in dots]
    assert any(marked)
    for number, outlying in enumerate(marked, 1):
        assert bool(opened.pixels(f"strip-{number}", "other-0")["all"]) == bool(outlying)
        assert opened.pixels(f"strip-{number}", "clean")["all"] > 100
    search(opened.page, "nothing of this")
    for number in range(1, 4):
        assert opened.pixels(f"strip-{number}", "clean")["all"] == 0, "what is not asked for is faint"


def test_the_dark_has_colours_of_its_own_and_narrow_windows_do_not_scroll_sideways(open_fleet: OpenFleet) -> None:
    opened = open_fleet(fleet(), viewport={"width": 400, "height": 800})
    page = opened.page
    paper = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    drawn = opened.pixels("strip-1", "clean")["all"]
    page.emulate_media(color_scheme="dark")
    settle(page)
    assert page.evaluate("() => getComputedStyle(document.body).backgroundColor") != paper
    assert opened.pixels("strip-1", "clean")["all"] == pytest.approx(drawn, rel=0.1)
    page.locator("#table tbody [aria-expanded]").nth(2).click()
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 400
    for cell in page.locator("#table tbody [aria-expanded]").nth(5).locator("td").all():
        box = cell.bounding_box()
        assert box is None or box["x"] + box["width"] <= 400


def test_print_has_the_worst_with_their_sentences(open_fleet: OpenFleet, tmp_path: Path) -> None:
    reader = shutil.which("pdftotext")
    if reader is None:
        pytest.skip("pdftotext reads what was printed: install Debian's poppler-utils")
    page = open_fleet(fleet()).page
    before = page.evaluate("() => document.querySelector('#table').innerText")
    page.pdf(path=tmp_path / "fleet.pdf")
    text = subprocess.run(
        [reader, "-layout", tmp_path / "fleet.pdf", "-"], capture_output=True, text=True, check=True
    ).stdout
    for row in fleet()[:300]:
        assert row.sensor in text
    for row in fleet()[:5]:
        assert " ".join((row.reason or row.says).split()[:6]) in " ".join(text.split())
    assert "And 300 more" in text
    assert "Search" not in text
    assert page.evaluate("() => document.querySelector('#table').innerText") == before


def test_ten_thousand_sensors_open_in_a_second(browser: Browser, tmp_path: Path) -> None:
    rows, path = simulated(10_000), tmp_path / "fleet.html"
    path.write_text(fleet_page(rows, facts_of(rows)), encoding="utf-8")
    assert path.stat().st_size < MOST_BYTES
    found = timed(browser, path, 3)
    assert median(found.opens) <= MOST_OPENS_MS
    for kind, took in found.answers.items():
        assert median(took) <= MOST_ANSWERS_MS, kind
