"""The tuner's page in a browser: opened, zoomed, turned, judged and saved, by hand and by keyboard, in any window."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from app_runs import App, tuner
from becalm.cleaning.recipes.recipe import Recipe
from becalm.files.inputs.opening import read
from tuning import NAMELESS, Look, chromium, drive, looking

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow

CANCEL = """() => {  // as a browser does, which tells of no pointerup then
  addEventListener("pointerup", (event) => event.stopImmediatePropagation(), { capture: true, once: true });
  document.querySelector("#map .u-over").dispatchEvent(new PointerEvent("pointercancel"));
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tuner") / "drives"
    folder.mkdir()
    drive(folder / "drive.parquet")
    (folder / "broken.csv").write_text("time,x\n0,zero\n1,one\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def app(folder: Path) -> Iterator[App]:
    with tuner(folder) as running:
        yield running


@pytest.fixture(scope="module")
def untouched(folder: Path) -> Iterator[App]:
    """Serve files of which none is opened."""
    with tuner(folder) as running:
        yield running


@pytest.fixture
def look(browser: Browser) -> Iterator[Look]:
    with looking(browser) as at:
        yield at


def test_a_file_is_opened_judged_and_saved(app: App, folder: Path, look: Look, tmp_path: Path) -> None:
    visit = look(app)
    page = visit.page
    assert page.locator("#facts").inner_text().startswith("drive.parquet: 12,000 rows at 100 Hz, 120 s")
    visit.judged()
    assert page.locator("#verdict").inner_text().startswith(("✓", "!", "✗"))
    assert page.locator("#figures figure:visible").count() >= 5
    assert page.locator("#lanes").get_attribute("aria-label") == "Verdicts in view: outlier in 3 places."
    for role in ("readings", "clean"):
        assert visit.pixels(role)["all"] > 500
    assert page.evaluate(NAMELESS) == []
    assert page.locator("#command").inner_text().startswith("becalm clean drive.parquet -o ")
    saved = visit.save("save-recipe", tmp_path)
    assert saved.name == "drive.recipe.toml"
    recipe = Recipe.from_toml(saved.read_text(encoding="utf-8"))
    assert recipe == Recipe.from_toml(page.evaluate("() => becalm.desk.state.recipe"))
    assert recipe.channel[0].process_noise_density == visit.settings()["process_noise_density"]
    clean = read(visit.save("save-clean", tmp_path))
    assert len(clean) == len(read(folder / "drive.parquet"))
    assert visit.save("save-report", tmp_path).read_text(encoding="utf-8").startswith("<!doctype html>")


def test_a_file_that_cannot_be_read_is_told_in_a_sentence(app: App, look: Look) -> None:
    visit = look(app, "")
    visit.page.keyboard.press("o")
    visit.page.locator("#folder button", has_text="broken.csv").click()
    trouble = visit.page.locator("#trouble")
    trouble.wait_for()
    assert "broken.csv" in trouble.inner_text()
    visit.shoot("tuner-trouble-1400-light")
    visit.page.locator("#folder button", has_text="drive.parquet").click()
    trouble.wait_for(state="hidden")
    app.shows = "drive.parquet"
    visit.opened("drive.parquet")


def test_zooming_and_moving(app: App, look: Look) -> None:
    visit = look(app)
    page = visit.page
    left, top, width, height = visit.over()
    middle = top + height / 2
    whole = visit.view()
    assert whole == pytest.approx((0, 120), abs=0.05)
    page.mouse.move(left + 0.25 * width, middle)
    page.mouse.down()
    page.mouse.move(left + 0.5 * width, middle, steps=4)
    page.mouse.up()
    assert visit.view() == pytest.approx((30, 60), abs=0.5)
    page.mouse.move(left + 0.5 * width, middle)
    page.mouse.wheel(0, -200)
    low, high = visit.view()
    assert 30 < low < 45 < high < 60
    assert (low + high) / 2 == pytest.approx(45, abs=0.5), "about the cursor"
    page.keyboard.down("Shift")
    page.mouse.down()
    page.mouse.move(left + 0.4 * width, middle, steps=4)
    page.mouse.up()
    page.keyboard.up("Shift")
    moved = visit.view()
    assert moved[0] - low == pytest.approx(0.1 * (high - low), rel=0.1)
    assert moved[1] - moved[0] == pytest.approx(high - low)
    page.mouse.wheel(120, 0)
    assert visit.view()[0] > moved[0]
    page.mouse.dblclick(left + 0.5 * width, middle)
    assert visit.view() == pytest.approx(whole)
    for key, inside in (("+", (30, 90)), ("+", (45, 75)), ("ArrowRight", (51, 81)), ("-", (36, 96)), ("0", whole)):
        page.keyboard.press(key)
        assert visit.view() == pytest.approx(inside, abs=0.1), key


def test_the_dial_turns_the_filter_and_can_be_taken_back(app: App, look: Look) -> None:
    visit = look(app)
    page, before = visit.page, visit.settings()
    visit.judged()
    drawn, told = visit.pixels("clean"), page.locator("#dial-says").inner_text()
    dial = page.locator("#dial")
    box = dial.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.1 * box["width"], box["y"] + box["height"] / 2, steps=8)
    page.wait_for_function("(old) => document.querySelector('#dial-says').innerText !== old", arg=told)
    page.mouse.up()
    after = visit.changed(before)
    assert after["process_noise_density"] > 10 * before["process_noise_density"], "quicker"
    assert visit.pixels("clean")["sum"] != drawn["sum"]
    assert "Hz" in (dial.get_attribute("aria-valuetext") or "")
    page.keyboard.press("]")
    calmer = visit.changed(after)
    assert calmer["process_noise_density"] < after["process_noise_density"]
    page.keyboard.press("z")
    assert visit.changed(calmer) == after
    page.locator("#undo").click()
    assert visit.changed(after) == before
    assert visit.draws("clean", drawn)
    page.keyboard.press("Shift+Z")
    assert visit.changed(before) == after
    page.locator("#tuned").click()
    assert visit.changed(after) == before, "as becalm tuned it"


def test_another_model_other_parts_and_another_mode(app: App, look: Look) -> None:
    visit = look(app)
    page, before = visit.page, visit.settings()
    assert all(text.strip() for text in page.locator("#choice-list small").all_inner_texts()[1:]), "evidence"
    page.locator("#choice-list input[value=order-1]").check()
    first = visit.changed(before)
    assert (first["choice"], first["order"]) == ("order-1", 1)
    page.locator("#choice-list input[value=found]").check()
    assert visit.changed(first) == before
    page.locator("#part-list input[value=tone-0]").uncheck()
    toneless = visit.changed(before)
    assert toneless["on"]["tone-0"] is False
    assert len(Recipe.from_toml(page.evaluate("() => becalm.desk.state.recipe")).channel[0].tone) == 0
    page.locator("#undo").click()
    visit.changed(toneless)
    page.locator("#mode").select_option("causal")
    page.wait_for_function("() => becalm.desk.state.mode === 'causal'")
    visit.idle()
    page.locator("#classic").select_option(index=1)
    page.wait_for_function("() => !document.querySelector('#plot .legend').lastElementChild.hidden")
    assert visit.pixels("other-0")["all"] > 20
    page.locator("#mode").select_option("smoothed")
    page.wait_for_function("() => becalm.desk.state.mode === 'smoothed'")


def test_a_key_that_is_held_is_one_turn(app: App, look: Look) -> None:
    visit = look(app)
    page, before = visit.page, visit.settings()
    page.evaluate("() => { document.querySelector('#dialled').disabled = true; }")
    page.keyboard.press("]")
    assert not page.evaluate("() => becalm.dial.held")
    page.evaluate("() => { document.querySelector('#dialled').disabled = false; }")
    for _ in range(4):
        page.keyboard.down("]")
    assert page.evaluate("() => becalm.dial.held")
    page.keyboard.up("]")
    calmer = visit.changed(before)
    page.keyboard.press("z")
    assert visit.changed(calmer) == before


def test_a_touch_that_is_cancelled_tunes(app: App, look: Look) -> None:
    visit = look(app)
    visit.judged()
    page, before = visit.page, visit.settings()
    page.locator("#map .u-over").scroll_into_view_if_needed()
    page.locator("#map .u-over").hover(position={"x": 40, "y": 40})
    page.mouse.down()
    page.evaluate(CANCEL)
    after = visit.changed(before)
    page.mouse.up()
    page.keyboard.press("z")
    assert visit.changed(after) == before


def test_a_click_on_the_map_tunes(app: App, look: Look) -> None:
    visit = look(app)
    page, before = visit.page, visit.settings()
    visit.judged()
    visit.over()
    over = page.locator("#map .u-over")
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.7 * box["width"], box["y"] + 0.3 * box["height"])
    after = visit.changed(before)
    assert after["noise_std"] > 2 * before["noise_std"], "to the right of the middle"
    assert after["process_noise_density"] > 10 * before["process_noise_density"], "above the middle"
    assert "worse than at best" in page.locator("#map-says").inner_text()
    page.locator("#map .canvas").focus()
    page.keyboard.press("ArrowLeft")
    walked = visit.changed(after)
    assert walked["noise_std"] < after["noise_std"]
    assert walked["process_noise_density"] == pytest.approx(after["process_noise_density"])
    for setting in (walked, after):
        page.keyboard.press("z")
        visit.changed(setting)
    assert visit.settings() == before


def test_from_opening_to_saving_by_keyboard_alone(app: App, look: Look, tmp_path: Path) -> None:
    visit = look(app, reduced_motion="reduce")
    page = visit.page
    page.keyboard.press("o")
    visit.walk_to("drive.parquet")
    page.keyboard.press("Enter")
    page.locator("#files").wait_for(state="hidden")
    visit.opened("drive.parquet")
    assert page.evaluate("() => document.activeElement.id") == "show-files", "not lost with the list"
    before = visit.settings()
    visit.walk_to("From faster to smoother")
    page.keyboard.press("[")
    visit.changed(before)
    visit.walk_to("Save recipe")
    with page.expect_download() as held:
        page.keyboard.press("Enter")
    held.value.save_as(tmp_path / "kept.toml")
    recipe = Recipe.from_toml((tmp_path / "kept.toml").read_text(encoding="utf-8"))
    assert recipe.channel[0].process_noise_density == visit.settings()["process_noise_density"]
    page.keyboard.press("z")


def test_what_is_the_same_is_not_read_aloud_again(app: App, look: Look) -> None:
    visit = look(app)
    visit.judged()
    visit.page.evaluate("""() => {
      Object.assign(window, { written: 0, before: becalm.desk.state });
      const observer = new MutationObserver(() => { written += 1; });
      for (const id of ["verdict", "map-says"]) observer.observe(document.getElementById(id), { childList: true });
      document.getElementById("mode").dispatchEvent(new Event("change"));
    }""")
    visit.page.wait_for_function("() => becalm.desk.state !== before")
    assert visit.page.evaluate("() => written") == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 400])
def test_nothing_overflows_in_any_window(width: int, scheme: str, app: App, untouched: App, look: Look) -> None:
    how = {"viewport": {"width": width, "height": 900}, "color_scheme": scheme}
    empty = look(untouched, "", **how)
    empty.page.locator("#folder button").first.wait_for()
    empty.shoot(f"tuner-empty-{width}-{scheme}")
    assert empty.page.evaluate("() => document.documentElement.scrollWidth") <= width
    visit = look(app, **how)
    page = visit.page
    visit.judged()
    visit.shoot(f"tuner-{width}-{scheme}")
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    paper = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(255, 255, 255)") == (scheme == "light")
    light = page.evaluate("() => getComputedStyle(document.documentElement).getPropertyValue('--clean')") == "#0f62c4"
    assert light == (scheme == "light")
    assert visit.pixels("clean")["all"] > 300, "in the colours of the theme"
