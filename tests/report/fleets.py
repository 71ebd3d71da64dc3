"""A fleet that has something of all there is, and its page in a browser that is offline."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from app_runs import CHROMIUM, QUIET
from becalm.report.fleet.fleet_order import TRAITS, worst_first
from becalm.report.fleet.fleet_page import FleetFacts, fleet_page
from becalm.report.fleet.fleet_rows import FleetRow
from browsing import Opened, settle
from fleet_report import facts_of, simulated

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page

OpenFleet = Callable[..., Opened]
FINE = FleetRow("s", "a", "V", verdict="fits", health=1.0, noise_std=0.1, usable_share=1.0, rows=100, rate_hz=10.0)
_NOISY: dict[str, Any] = {"noise_std": 5.0, "outlying": "Its noise is many times that of its class."}
_APART: dict[int, dict[str, Any]] = {
    10: {"state": "refused", "reason": "It has no row whose time is known.", "verdict": "", "health": None},
    20: {"outlying": "It lags."},
    21: _NOISY,
    22: _NOISY,
    30: {"state": "kept"},
    40: {"verdict": "constant", "health": None, "noise_std": None},
}


@cache
def fleet() -> list[FleetRow]:
    """Return a simulated fleet, the worst first, some of which is refused, outlying, kept, or not judged."""
    return worst_first([replace(row, **_APART.get(place, {})) for place, row in enumerate(simulated(600))])


def traits_of(row: FleetRow) -> list[str]:
    """Return what is true of a row, by name."""
    return [trait.name for trait in TRAITS if trait.holds(row)]


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start a browser, until the block ends."""
    driver = pytest.importorskip("playwright.sync_api", reason="a browser looks at the page: pip install playwright")
    if CHROMIUM is None:
        pytest.skip("a browser looks at the page: install Debian's chromium")
    with driver.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield browser
        browser.close()


@contextmanager
def opening(browser: Browser, folder: Path) -> Iterator[OpenFleet]:
    """Open pages of rows as a reader does, in windows that have no network; nothing may go wrong in any of them."""
    opened: list[tuple[Opened, BrowserContext]] = []
    path = folder / "fleet.html"

    def open_it(rows: list[FleetRow], facts: FleetFacts | None = None, **more: Any) -> Opened:
        path.write_text(fleet_page(rows, facts or facts_of(rows)), encoding="utf-8")
        context = browser.new_context(offline=True, **{"viewport": {"width": 1300, "height": 900}, **more})
        one = Opened(context.new_page(), [], [])
        opened.append((one, context))
        one.page.on("pageerror", lambda error: one.wrong.append(str(error)))
        one.page.on("console", lambda said: one.wrong.append(said.text) if _is_wrong(said) else None)
        one.page.on("request", lambda request: one.asked.append(request.url))
        one.page.goto(path.as_uri())
        one.page.wait_for_function("() => window.becalmFleet")
        settle(one.page)
        return one

    yield open_it
    for one, context in opened:
        context.close()
        assert one.wrong == []
        assert one.asked == [path.as_uri()]


def _is_wrong(said: ConsoleMessage) -> bool:
    """Whether a page complains, but for what Chromium says of counting pixels."""
    return said.type in ("error", "warning") and "willReadFrequently" not in said.text


def shown(page: Page) -> list[FleetRow]:
    """Return the rows of the fleet that a page shows, in their order."""
    return [fleet()[place] for place in page.evaluate("() => becalmFleet.table.rows")]


def choose(page: Page, name: str) -> None:
    """Press a filter."""
    page.locator(f".filters button:has-text('{name}')").first.click()


def search(page: Page, words: str) -> None:
    """Ask for rows that have all words."""
    page.locator("#search").fill(words)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Give Chromium to the tests of a module."""
    with chromium() as found:
        yield found


@pytest.fixture
def open_fleet(browser: Browser, tmp_path: Path) -> Iterator[OpenFleet]:
    """Give what opens a fleet's page, and fails at an error in it or a request from it."""
    with opening(browser, tmp_path) as opened:
        yield opened
