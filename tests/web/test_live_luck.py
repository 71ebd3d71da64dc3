"""The live page where luck is bad: it says what is true of late bins, leaps of time, silence, and odd figures."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

import numpy as np
import pytest

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.core.recording import Recording
from becalm.files.outputs.writing import write
from live_looks import drawn, settle
from live_page_runs import LiveApp, shown_live
from tuning import Visit, chromium, visiting

if TYPE_CHECKING:
    from playwright.sync_api import Browser, WebSocketRoute

pytestmark = pytest.mark.slow

RATE_HZ = 1000.0
NEWEST = "Math.floor(becalmLive.view.newest / becalmLive.view.rowsEach[becalmLive.view.level]) - 1"
UPDATES = "() => becalmLive.counts.updates"
HOLES = """() => {
  const { view, counts, store } = becalmLive;
  const each = view.rowsEach[view.level];
  const begin = Math.ceil(Math.max(view.right - view.rows, 0) / each);
  const bins = Array.from({ length: Math.floor(view.right / each) - begin }, (_, k) => begin + k);
  return [bins.filter((bin) => !store().has(bin)).length, counts.gaps];
}"""

Look = Callable[[LiveApp], Visit]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApp]:
    """Show five minutes of noise."""
    folder = tmp_path_factory.mktemp("luck")
    noise = np.random.default_rng(4).normal(0, 0.4, (300_000, 1))
    write(folder / "rig.parquet", Recording(noise, names=["force"], units=["N"], rate_hz=RATE_HZ))
    channel = ChannelRecipe(name="force", unit="N", model="motion", order=2, process_noise_density=40.0, noise_std=0.4)
    recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=RATE_HZ), channel=(channel,))
    (folder / "rig.toml").write_text(recipe.to_toml(), encoding="utf-8")
    source, recipe_file = f"replay:{folder / 'rig.parquet'}?speed=1", str(folder / "rig.toml")
    with shown_live(folder, source, "--recipe", recipe_file, "--sink", "journal:journal") as running:
        yield running


@pytest.fixture
def look(browser: Browser) -> Iterator[Look]:
    """Look on through a new window; whatever goes wrong there fails the test."""
    with ExitStack() as stack:
        visits = []

        def at(app: LiveApp) -> Visit:
            visits.append(visit := stack.enter_context(visiting(browser, app.base)))
            visit.page.goto(app.url)
            visit.page.wait_for_function("() => window.becalmLive?.counts.bins > 300")
            return visit

        yield at
        for visit in visits:
            assert visit.wrong == []


def test_no_bin_is_missing_where_less_and_more_time_is_asked_for_at_once(live: LiveApp, browser: Browser) -> None:
    """Bins of what was followed before are on their way still."""
    late: list[str | bytes] = []
    with visiting(browser, live.base) as visit:
        page, slow = visit.page, False

        def pass_on(wire: WebSocketRoute) -> None:
            server = wire.connect_to_server()
            server.on_message(lambda told: late.append(told) if slow else wire.send(told))
            ways.append(wire)

        ways: list[WebSocketRoute] = []
        page.route_web_socket("**/wire", pass_on)
        page.goto(live.url)
        page.wait_for_function("() => window.becalmLive?.counts.bins > 300")
        slow = True
        while sum(isinstance(told, bytes) for told in late) < 5:
            page.wait_for_timeout(20)
        page.evaluate("() => { for (const key of '-+') dispatchEvent(new KeyboardEvent('keydown', { key })); }")
        for told in late:
            ways[0].send(told)
        slow = False
        page.wait_for_function("(before) => becalmLive.counts.updates > before + 3", arg=page.evaluate(UPDATES))
        assert page.evaluate(HOLES) == [0, 0]
        assert visit.wrong == []


def test_times_are_those_of_stamps_where_time_leaps(live: LiveApp, look: Look) -> None:
    ticks, before, at, after = look(live).page.evaluate("""async () => {
      const { Store } = await import("/assets/live/store.js");
      const { ticksOf, timeOf } = await import("/assets/live/axis.js");
      const store = new Store(0, 0);
      for (let bin = 50; bin < 800; bin += 1) {
        store.number[bin] = bin;
        store.t[bin] = bin / 100 + (bin < 400 ? 0 : 60);
      }
      const ticks = ticksOf(store, 1, 100, 0, 800, 950 * devicePixelRatio);
      return [ticks, ...[20, 390, 410].map((row) => timeOf(store, 1, row, 100))];
    }""")
    assert [words for _, words in ticks] == ["1 s", "2 s", "3 s", "64 s", "65 s", "66 s", "67 s"]
    assert [x for x, _ in ticks] == pytest.approx([950 * seconds / 8 for seconds in range(1, 8)])
    assert (before, at, after) == (None, 3.9, 64.1)


def test_a_silence_of_becalm_is_said(live: LiveApp, look: Look) -> None:
    page = look(live).page
    live.process.send_signal(signal.SIGSTOP)
    try:
        page.wait_for_function("() => document.querySelector('#link').innerText.includes('has sent nothing')")
        assert page.evaluate("() => document.body.dataset.state") == "disconnected"
        page.wait_for_function("() => document.querySelector('#when').innerText.startsWith('until')")
    finally:
        live.process.send_signal(signal.SIGCONT)
    page.wait_for_function("() => document.body.dataset.state === 'live' && link.hidden")
    page.wait_for_function("() => document.querySelector('#when').innerText.startsWith('now')")


def test_a_turn_that_nobody_hears_is_none(live: LiveApp, browser: Browser) -> None:
    with visiting(browser, live.base) as visit:
        page = visit.page
        wires: list[WebSocketRoute] = []

        def pass_on(wire: WebSocketRoute) -> None:
            wires.append(wire)
            wire.connect_to_server()

        page.route_web_socket("**/wire", pass_on)
        page.goto(live.url)
        page.wait_for_function("() => window.becalmLive && !document.querySelector('.strip input').disabled")
        words = page.locator("section.strip dl").inner_text()
        page.evaluate("() => { WebSocket.prototype.send = () => {}; }")
        page.keyboard.press("1")
        page.keyboard.press("]")
        assert page.locator("section.strip dl").inner_text() != words
        wires[0].close()
        page.wait_for_function("() => document.body.dataset.state === 'disconnected'")
        assert page.locator("section.strip dl").inner_text() == words
        page.keyboard.press("]")
        assert page.locator("section.strip dl").inner_text() == words


def test_what_came_stays_however_it_is_looked_at(live: LiveApp, browser: Browser) -> None:
    with visiting(browser, live.base) as visit:
        page, gone = visit.page, False
        wires: list[WebSocketRoute] = []

        def pass_on(wire: WebSocketRoute) -> None:
            if gone:
                wire.close()
            else:
                wires.append(wire)
                wire.connect_to_server()

        page.route_web_socket("**/wire", pass_on)
        page.goto(live.url)
        page.wait_for_function("() => window.becalmLive?.counts.bins > 300")
        gone = True
        wires[0].close()
        page.wait_for_function("() => document.body.dataset.state === 'disconnected'")
        for keys in ("--", " ++", "n"):
            for key in keys:
                page.keyboard.press(key)
            settle(visit)
            drawn(visit, 0, "clean", 20)
        page.keyboard.press("-")
        page.keyboard.press("-")
        gone = False
        page.wait_for_function("() => document.body.dataset.state === 'live' && becalmLive.view.level === 1")
        page.wait_for_function(f"() => !becalmLive.view.paused && becalmLive.store().has({NEWEST})")
        assert page.evaluate(HOLES)[0] == 0


def test_why_a_stream_failed_stays(live: LiveApp, browser: Browser) -> None:
    with visiting(browser, live.base) as visit:
        page = visit.page

        def fail(wire: WebSocketRoute) -> None:
            def pass_on(told: str | bytes) -> None:
                if isinstance(told, str) and '"running"' in told:
                    wire.send(told.replace('"running"', '"failed"').replace('"says":""', '"says":"It burns."', 1))
                    wire.close()

            wire.connect_to_server().on_message(pass_on)

        page.route_web_socket("**/wire", fail)
        page.goto(live.url)
        page.wait_for_function("() => document.body.dataset.state === 'disconnected'")
        assert page.locator("#working").inner_text() == "The stream failed: It burns."
        assert "has ended" in page.locator("#link").inner_text()


FIGURES = [
    (20.2345, 0.21, "20.23 ± 0.21"),
    (-101325.0, 0.06, "-101325.000 ± 0.060"),
    (7.0, 250.0, "7 ± 250"),
    (-1.234e-12, 2.1e-13, "-1.23e-12 ± 2.1e-13"),
    (1.2345e25, 3e20, "1.234500e25 ± 3.0e20"),
    (0.0, 1e-13, "0 ± 1.0e-13"),
    (1.5, float("nan"), "1.5000"),
    (3e-9, float("nan"), "3.0000e-9"),
    (float("nan"), 0.2, "no ± 0.20"),
]


def test_figures_are_told_in_digits_that_mean_something(live: LiveApp, look: Look) -> None:
    about = """async ([value, spread]) => {
      const { about } = await import("/assets/live/strip.js");
      return about(value, spread).join("");
    }"""
    page = look(live).page
    for value, spread, words in FIGURES:
        told = page.evaluate(about, [value, spread])
        assert told.replace("\N{MINUS SIGN}", "-").replace("\N{EN DASH}", "no") == words


def test_no_digit_of_an_axis_is_cut_off(live: LiveApp, look: Look) -> None:
    page = look(live).page
    left = page.evaluate("""() => {
      const [strip] = becalmLive.strips;
      strip.scale = { low: 101324.97, high: 101325.03 };
      strip.draw({ store: becalmLive.store(), each: 7, perRow: 0.1, right: 7e4, newest: 0, ticks: [] });
      const { data } = strip.pen.getImageData(0, 0, Math.floor(devicePixelRatio), strip.canvas.height);
      return data.some((one) => one > 0);
    }""")
    assert not left


def test_a_constant_is_drawn_within_its_uncertainty(live: LiveApp, look: Look) -> None:
    low, high = look(live).page.evaluate("""async () => {
      const { Store } = await import("/assets/live/store.js");
      const [strip] = becalmLive.strips;
      const store = new Store(1, 0);
      store.number[0] = 0;
      for (const values of Object.values(store.values)) values[0] = 7;
      store.values.sigma[0] = 0.25;
      strip.scale = null;
      strip.rescale({ store, each: 1, perRow: 1, right: 1, newest: 1 });
      return [strip.scale.low, strip.scale.high];
    }""")
    assert (low, high) == (6.35, 7.65)
