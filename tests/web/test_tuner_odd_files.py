"""Files on the tuner's page that are out of the ordinary: hardly any rows, large numbers, slow rates."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from app_runs import App, tuner
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.files.outputs.writing import write
from tuning import Look, chromium, looking

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> Iterator[App]:
    folder = tmp_path_factory.mktemp("odd") / "drives"
    folder.mkdir()
    noise = np.random.default_rng(3).normal(0, 0.3, 400)
    kept(folder / "short.csv", noise[:10], 100.0)
    kept(folder / "large.csv", 4e15 + noise, 100.0)
    kept(folder / "slow.csv", noise, 0.01)
    kept(folder / "usual.csv", noise, 100.0)
    with tuner(folder) as running:
        yield running


@pytest.fixture
def look(browser: Browser) -> Iterator[Look]:
    with looking(browser) as at:
        yield at


def kept(path: Path, values: Floats, rate_hz: float) -> None:
    write(path, Recording(values[:, np.newaxis], names=["load"], units=["N"], rate_hz=rate_hz))


def test_a_file_without_times_is_opened_at_a_rate(look: Look, tmp_path: Path) -> None:
    (tmp_path / "timeless.csv").write_text("load\n" + "0.5\n0.25\n" * 200, encoding="utf-8")
    with tuner(tmp_path, str(tmp_path / "timeless.csv")) as alone:
        visit = look(alone, "")
        page = visit.page
        page.locator("#trouble", has_text="the rate (Hz) below").wait_for()
        page.locator("#rate").fill("50")
        page.locator("#folder button", has_text="timeless.csv").click()
        page.locator("#facts", has_text="400 rows at 50 Hz").wait_for()
        assert page.locator("#files").is_hidden()
        alone.kill()
        page.wait_for_function("() => document.body.dataset.state === 'disconnected'")
        alone.start_again()
        page.locator("#trouble", has_text="the rate (Hz) below").wait_for(state="hidden")
        page.wait_for_function("() => document.body.dataset.state === 'open' && becalm.desk.restoring === null")
        assert page.locator("#facts").inner_text().startswith("timeless.csv: 400 rows at 50 Hz")
        visit.forgive_silence()


def test_a_map_of_too_few_readings_is_no_trouble(app: App, look: Look) -> None:
    page = look(app, "short.csv").page
    page.wait_for_function("() => document.querySelector('#map-says').innerText.startsWith('Too few readings')")
    assert page.locator("#trouble").is_hidden()
    page.wait_for_function("() => document.querySelector('#verdict').innerText.startsWith('✓')")


def test_large_numbers_are_looked_at_from_near(app: App, look: Look) -> None:
    visit = look(app, "large.csv")
    for _ in range(8):
        visit.page.keyboard.press("+")
    low, high = visit.view()
    assert high - low < 0.04
    assert visit.pixels("clean")["all"] > 50


def test_a_lag_is_proposed_for_each_file(app: App, look: Look) -> None:
    visit = look(app, "usual.csv")
    page = visit.page
    for mode in ("lagged", "smoothed"):
        page.locator("#mode").select_option(mode)
        page.wait_for_function("(mode) => becalm.desk.state.mode === mode", arg=mode)
        visit.idle()
    visit.open_file(app, "slow.csv")
    page.locator("#mode").select_option("lagged")
    page.wait_for_function("() => becalm.desk.state.mode === 'lagged'")
    page.locator("#lag").fill("-1")
    page.locator("#lag").blur()
    assert page.locator("#lag").input_value() == "1000"
    assert page.locator("#trouble").is_hidden()
    for lag, says in (("1", "0 readings"), ("200", "")):
        page.locator("#lag").fill(lag)
        page.locator("#lag").blur()
        page.wait_for_function("(says) => document.querySelector('#trouble').innerText.includes(says)", arg=says)
    page.wait_for_function("() => becalm.desk.state.lag_s === 200")
    assert page.locator("#trouble").is_hidden()


def test_the_list_of_files_stays_while_another_page_changes_the_mode(app: App, look: Look) -> None:
    visit, other = look(app, "usual.csv"), look(app, "usual.csv")
    visit.page.locator("#show-files").click()
    other.page.locator("#mode").select_option("causal")
    visit.page.wait_for_function("() => becalm.desk.state.mode === 'causal'")
    assert visit.page.locator("#files").is_visible()
