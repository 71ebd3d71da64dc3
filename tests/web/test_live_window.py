"""The live page in a browser: it draws what comes, stands still, looks back, turns the dial, and comes back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe, ModeRecipe, SwitchingRecipe
from becalm.core.recording import Recording
from becalm.files.outputs.writing import write
from live_looks import COLUMNS, PIXELS, drawn, pixels, recipe_now, settle, tune_by_key
from live_page_runs import LiveApp, shown_live
from tuning import NAMELESS, Visit, chromium, visiting

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow

RATE_HZ, SECONDS = 1000.0, 600
SPIKE_ROWS = slice(2500, None, 5000)
Look = Callable[..., Visit]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write ten minutes of a motion with spikes, of a speed that rests between its motions, and a recipe for them."""
    folder = tmp_path_factory.mktemp("live")
    rng, rows = np.random.default_rng(4), int(RATE_HZ * SECONDS)
    t = np.arange(rows) / RATE_HZ
    force = 20 + 3 * np.sin(2 * np.pi * 0.4 * t) + rng.normal(0, 0.4, rows)
    force[SPIKE_ROWS] += 15.0
    speed = np.where(t % 4 > 2, np.sin(2 * np.pi * 2 * t), 0.0) + rng.normal(0, 0.05, rows)
    values = np.column_stack([force, speed])
    write(folder / "rig.parquet", Recording(values, names=["force", "speed"], units=["N", "m/s"], rate_hz=RATE_HZ))
    still = ModeRecipe(name="still", order=1, process_noise_density=1e-6, noise_std=0.05, lasts_s=2.0)
    moving = ModeRecipe(name="moving", order=2, process_noise_density=3e3, noise_std=0.05, lasts_s=2.0)
    numbers: dict[str, Any] = {"model": "motion", "order": 2, "process_noise_density": 40.0}
    switching = SwitchingRecipe(kind="resting", mode=(still, moving))
    channels = (
        ChannelRecipe(name="force", unit="N", noise_std=0.4, gate=GateRecipe(), **numbers),
        ChannelRecipe(name="speed", unit="m/s", noise_std=0.05, switching=switching, **numbers),
    )
    recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=RATE_HZ), channel=channels)
    (folder / "rig.toml").write_text(recipe.to_toml(), encoding="utf-8")
    return folder


def rig(folder: Path, *words: str) -> tuple[Path, str, *tuple[str, ...]]:
    source = f"replay:{folder / 'rig.parquet'}?speed=1"
    return folder, source, *(words or ("--recipe", str(folder / "rig.toml"), "--sink", "journal:journal"))


@pytest.fixture(scope="module")
def live(folder: Path) -> Iterator[LiveApp]:
    with shown_live(*rig(folder)) as running:
        yield running


@pytest.fixture
def look(browser: Browser) -> Iterator[Look]:
    """Look on through a new window; whatever goes wrong there fails the test."""
    with ExitStack() as stack:
        visits = []

        def at(app: LiveApp, *, begun: bool = True, **more: Any) -> Visit:
            visit = stack.enter_context(visiting(browser, app.base, **more))
            visits.append(visit)
            visit.page.goto(app.url)
            if begun:
                visit.page.wait_for_function("() => window.becalmLive?.counts.bins > 300")
            return visit

        yield at
        for visit in visits:
            assert visit.wrong == []
            assert visit.foreign == []


def test_what_comes_is_drawn_and_told(live: LiveApp, look: Look, tmp_path: Path) -> None:
    visit = look(live)
    page = visit.page
    page.wait_for_function("() => becalmLive.counts.frames > 60 && document.querySelector('#health dd')")
    for number in (0, 1):
        for role in ("readings", "clean"):
            drawn(visit, number, role)
    assert page.evaluate("() => becalmLive.counts.gaps") == 0
    assert "running" in page.locator("#facts").inner_text()
    force, speed = page.locator("section.strip").all()
    page.wait_for_function("() => document.querySelector('.met').innerText.includes('spike')")
    assert "±" in force.locator("output").inner_text()
    page.wait_for_function("() => !document.querySelector('.strip input').disabled")
    assert "bandwidth" in force.locator("dl").inner_text()
    assert "still" in speed.locator("dl").inner_text(), "what switches has no dial, but modes"
    canvas = speed.locator("canvas")
    assert canvas.get_attribute("aria-label") == "speed", "not what changes four times a second"
    value, met = (canvas.get_attribute("aria-describedby") or "").split()
    assert "±" in page.locator(f"#{value}").inner_text()
    assert "moving" in page.locator(f"#{met}").inner_text()
    assert page.evaluate(NAMELESS) == []
    saved = visit.save("save", tmp_path)
    assert (saved.name, Recipe.from_toml(saved.read_text())) == ("live.recipe.toml", recipe_now(visit))
    visit.shoot("live-1400-light")


def test_it_scrolls_and_stands_still_and_looks_back(live: LiveApp, look: Look) -> None:
    visit = look(live)
    page = visit.page
    before = page.evaluate("() => becalmLive.view.right")
    page.wait_for_function("(before) => becalmLive.view.right > before + 500", arg=before)
    page.keyboard.press("Space")
    settle(visit)
    stood, newest = page.evaluate("() => [becalmLive.view.right, becalmLive.view.newest]")
    picture = pixels(visit, 0, "clean")
    page.wait_for_function("(newest) => becalmLive.view.newest > newest + 500", arg=newest)
    assert page.evaluate("() => becalmLive.view.right") == stood
    assert pixels(visit, 0, "clean") == picture
    assert "paused" in page.locator("#when").inner_text()
    page.wait_for_function("() => becalmLive.view.newest > 6000")
    page.keyboard.press("n")
    page.wait_for_function("() => !becalmLive.view.paused && becalmLive.view.newest - becalmLive.view.right < 1000")
    page.keyboard.press("ArrowLeft")
    page.wait_for_function("() => becalmLive.view.paused && becalmLive.view.right < becalmLive.view.newest - 2000")
    page.keyboard.press("+")
    page.keyboard.press("+")
    page.wait_for_function(f"() => ({PIXELS})([0, 'clean']).all > 100")
    box = page.locator("#strips canvas").first.bounding_box()
    assert box is not None
    at = page.evaluate("() => becalmLive.view.right")
    page.mouse.move(box["x"] + 300, box["y"] + 30)
    page.mouse.down()
    page.mouse.move(box["x"] + 500, box["y"] + 30, steps=4)
    page.mouse.up()
    dragged = page.evaluate("() => becalmLive.view.right")
    assert dragged < at
    window = page.evaluate("() => becalmLive.view.window_s")
    page.mouse.wheel(0, 120)
    page.wait_for_function("(window) => becalmLive.view.window_s > window", arg=window)
    visit.shoot("live-paused")
    page.locator("#now").click()
    page.wait_for_function("() => !becalmLive.view.paused")
    assert page.locator("#now").is_disabled()


def test_each_spike_of_one_row_is_seen_from_afar(live: LiveApp, look: Look) -> None:
    """However many bins share a column, and wherever the ring of columns has its seam."""
    visit = look(live)
    page = visit.page
    just = "becalmLive.view.newest % 5000 > 2650 && becalmLive.view.newest % 5000 < 2800"  # in a bin that is open yet
    page.wait_for_function(f"() => becalmLive.view.newest > 13500 && {just}")
    page.keyboard.press("Space")
    for wider in range(5):
        if wider:
            page.keyboard.press("-")
        page.wait_for_function("() => becalmLive.store().has(Math.floor(12500 / [7, 56, 448][becalmLive.view.level]))")
        page.wait_for_function("() => becalmLive.strips[0].scale?.high > 30")
        settle(visit)
        right, rows = page.evaluate("() => [becalmLive.view.right, becalmLive.view.rows]")
        spikes = [row for row in range(2500, int(right) - 30, 5000) if row > right - rows + 30]
        assert len(spikes) >= 1
        page.wait_for_function(f"(count) => ({COLUMNS})() === count", arg=len(spikes))  # once what was asked is drawn
        assert pixels(visit, 0, "clean")["top"] > 0.4, "the gate leaves them out"


def test_a_dial_is_turned_by_keys_and_undone(live: LiveApp, look: Look) -> None:
    visit = look(live)
    page = visit.page
    page.wait_for_function("() => !document.querySelector('.strip input').disabled")
    density = recipe_now(visit).channel[0].process_noise_density
    words = page.locator("section.strip dl").first.inner_text()
    page.keyboard.press("1")
    assert page.evaluate("() => document.activeElement === document.querySelector('#strips canvas')")
    for _ in range(3):
        tune_by_key(visit, "]")
    page.wait_for_function("() => !document.querySelector('#undo').disabled")
    calmer = recipe_now(visit).channel[0].process_noise_density
    assert density is not None
    assert calmer is not None
    assert calmer < density
    assert page.locator("section.strip dl").first.inner_text() != words
    other = look(live)
    other.page.wait_for_function("() => !document.querySelector('#undo').disabled")
    for _ in range(3):
        assert recipe_now(visit).channel[0].process_noise_density != density
        tune_by_key(visit, "z")
    assert recipe_now(visit).channel[0].process_noise_density == density
    page.wait_for_function("() => document.querySelector('#undo').disabled")
    other.page.wait_for_function("() => document.querySelector('#undo').disabled")


def test_it_comes_back_after_becalm_was_killed(folder: Path, look: Look, tmp_path: Path) -> None:
    with shown_live(tmp_path, *rig(folder)[1:]) as app:
        visit = look(app)
        page = visit.page
        page.wait_for_function("() => becalmLive.view.newest > 3000")
        app.kill()
        page.wait_for_function("() => document.body.dataset.state === 'disconnected'")
        page.locator("#link", has_text="open the address that it printed").wait_for()
        assert "does not answer;" in page.locator("#link").inner_text()
        visit.shoot("live-disconnected")
        assert pixels(visit, 0, "clean")["all"] > 100, "what came before stays"
        app.start_again()
        page.wait_for_function("() => document.body.dataset.state === 'live'")
        page.wait_for_function("() => document.querySelector('#link').innerText.includes('was restarted')")
        page.wait_for_function("() => becalmLive.counts.bins > 300 && becalmLive.view.newest > 3000")
        drawn(visit, 0, "clean")
        visit.wrong[:] = [one for one in visit.wrong if "ERR_CONNECTION_REFUSED" not in one]  # Chromium's own words


def test_a_key_that_is_held_is_one_turn(live: LiveApp, look: Look) -> None:
    visit = look(live)
    page = visit.page
    page.wait_for_function("() => !document.querySelector('.strip input').disabled")
    density = recipe_now(visit).channel[0].process_noise_density
    page.keyboard.press("1")
    for _ in range(4):
        page.keyboard.down("]")
    page.keyboard.up("]")
    page.wait_for_function("() => !document.querySelector('#undo').disabled")
    assert recipe_now(visit).channel[0].process_noise_density != density
    page.keyboard.press("z")
    page.wait_for_function("() => document.querySelector('#undo').disabled")
    assert recipe_now(visit).channel[0].process_noise_density == density


def test_a_dial_is_moved_by_no_news_of_before_its_last_turn(live: LiveApp, look: Look) -> None:
    page = look(live).page
    page.wait_for_function("() => !document.querySelector('.strip input').disabled")
    here, waiting, refused = page.evaluate("""() => {
      const strip = becalmLive.strips[0];
      const [filter, dial] = strip.known;
      const places = [strip.dial.input.value];
      strip.pending = 7;
      strip.tune(filter, { ...dial, at: dial.at / 8 });
      strip.answered(6, true);
      places.push(strip.dial.input.value);
      strip.answered(7, false);
      return [...places, strip.dial.input.value];
    }""")
    assert waiting == here
    assert float(refused) > float(here)


def test_a_recipe_that_cannot_be_saved_is_said(live: LiveApp, look: Look) -> None:
    visit = look(live)
    visit.page.route("**/save/recipe", lambda route: route.fulfill(status=400, body="This cannot be."))
    visit.page.locator("#save").click()
    visit.page.wait_for_function("() => document.querySelector('#trouble').innerText === 'This cannot be.'")
    visit.wrong[:] = [one for one in visit.wrong if "400" not in one]  # Chromium's own words


def test_an_end_is_said_and_what_came_stays(folder: Path, look: Look, tmp_path: Path) -> None:
    short = tmp_path / "short.parquet"
    rng = np.random.default_rng(3)
    values = np.column_stack([20 + rng.normal(0, 0.4, 5000), rng.normal(0, 0.05, 5000)])
    write(short, Recording(values, names=["force", "speed"], units=["N", "m/s"], rate_hz=RATE_HZ))
    with shown_live(tmp_path, f"replay:{short}?speed=1", *rig(folder)[2:]) as app:
        visit = look(app)
        visit.page.wait_for_function("() => document.querySelector('#link').innerText.includes('has ended')")
        assert visit.page.evaluate("() => becalmLive.view.newest") >= 5000
        settle(visit)
        drawn(visit, 0, "clean")
        visit.shoot("live-ended")
        visit.wrong[:] = [one for one in visit.wrong if "ERR_CONNECTION_REFUSED" not in one]


def test_learning_is_said(folder: Path, look: Look, tmp_path: Path) -> None:
    with shown_live(tmp_path, rig(folder)[1], "--learn", "20s") as app:
        visit = look(app, begun=False)
        visit.page.wait_for_function("() => document.querySelector('#working').innerText.includes('learns filters')")
        visit.page.wait_for_function("() => document.querySelector('#facts').innerText.includes('rows so far')")
        said = visit.page.locator("#working").inner_text()
        assert said == "becalm learns filters for this stream.", "no count, which would be read aloud each second"
        visit.shoot("live-learning")
    assert (tmp_path / "token").read_text().strip() not in (tmp_path / "live.log").read_text()


@pytest.mark.parametrize(("width", "theme"), [(400, "light"), (1400, "dark")])
def test_nothing_overflows(live: LiveApp, look: Look, width: int, theme: str) -> None:
    visit = look(live, viewport={"width": width, "height": 900}, color_scheme=theme, reduced_motion="reduce")
    visit.page.wait_for_function("() => !document.querySelector('.strip input').disabled")
    assert visit.page.evaluate("() => document.documentElement.scrollWidth") <= width
    drawn(visit, 0, "clean", 50)
    visit.shoot(f"live-{width}-{theme}")
