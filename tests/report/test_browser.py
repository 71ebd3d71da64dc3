"""The page in a browser that is offline: it draws, it can be looked into, by the eye and by the keyboard."""

from __future__ import annotations

import itertools
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from becalm.core.recording import Recording
from becalm.files.inputs.opening import read
from becalm.studies.drive import simulate
from browsing import PLOT_OF, TICKS, Opened, settle
from drawing import draw

if TYPE_CHECKING:
    from playwright.sync_api import Browser

DATA = Path(__file__).parents[2].parent / "shared" / "data"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
QUIET = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]
SPIKE_ROW, SPIKED_ROWS = 30_901, 50_000
CHANNELS = ["speed (m/s)", "acceleration_x (m/s^2)"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="a browser looks at the page: install Debian's chromium"),
]

Open = Callable[..., Opened]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    driver = pytest.importorskip("playwright.sync_api", reason="a browser looks at the page: pip install playwright")
    with driver.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Open]:
    """Open a page as a reader does, in a window that has no network."""
    contexts = []

    def opened(path: Path, **more: Any) -> Opened:
        context = browser.new_context(offline=True, **{"viewport": {"width": 1300, "height": 900}, **more})
        contexts.append(context)
        page, wrong, asked = context.new_page(), [], []
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_function("() => window.becalmPlots")
        settle(page)
        return Opened(page, wrong, asked)

    yield opened
    for context in contexts:
        context.close()


def written(folder: Path, recording: Recording, *, printed: bool = False) -> Path:
    """Write a page; what is for print takes a second a channel."""
    path = folder / "r.html"
    with pytest.MonkeyPatch.context() as patch:
        if not printed:
            patch.setattr("becalm.report.page.can_print", lambda: False)
        path.write_text(draw(recording).page(), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def spiked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(6)
    z = np.cumsum(rng.normal(0, 0.02, SPIKED_ROWS)) + rng.normal(0, 0.3, SPIKED_ROWS)
    z[SPIKE_ROW] = z.max() + np.ptp(z)
    z[20_000:22_000] = np.nan
    recording = Recording(z, names=["a"], units=["V"], rate_hz=100.0)
    return written(tmp_path_factory.mktemp("spiked"), recording, printed=True)


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a page of two channels, of which the first has a front of models."""
    whole = simulate().measured.select(CHANNELS)
    recording = Recording(whole.samples[:8000], names=whole.names, units=whole.units, rate_hz=whole.timebase.rate_hz)
    return written(tmp_path_factory.mktemp("driven"), recording)


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = DATA / "comma2k19" / "can_speed.csv"
    if not source.exists():
        pytest.skip("the recordings are not beside the project (comma2k19/can_speed.csv)")
    return written(tmp_path_factory.mktemp("real"), read(source))


@pytest.mark.parametrize("name", ["spiked", "driven", "real"])
def test_every_figure_is_drawn_and_nothing_is_asked_for(
    name: str, request: pytest.FixtureRequest, open_page: Open
) -> None:
    path = request.getfixturevalue(name)
    opened = open_page(path)
    figures = opened.page.evaluate("() => [...document.querySelectorAll('figure')].map((one) => one.id)")
    assert opened.wrong == []  # before pixels are counted, of which Chromium warns
    assert len(figures) >= 4
    for figure in figures:
        lines = [opened.pixels(figure, role)["all"] for role in ("clean", "other-0")]  # a lane, a front: other-0
        assert max(lines) > 20, figure
    assert opened.asked == [path.as_uri()]


def test_a_look_into_the_record_takes_its_verdicts_along(spiked: Path, open_page: Open) -> None:
    opened = open_page(spiked)
    signal, verdicts = "1-a-signal", "1-a-verdicts"
    whole = opened.scale(signal)
    assert opened.scale(verdicts) == pytest.approx(whole, rel=1e-3), "in line, to a pixel"
    assert whole == pytest.approx([0, (SPIKED_ROWS - 1) / 100], rel=1e-3)
    reset = opened.page.locator(f'[id="{signal}"] .reset')
    assert not reset.is_visible()
    for figure, back in ((signal, "button"), (verdicts, "button"), (signal, "double click")):
        opened.drag(figure, 0.25, 0.5)
        low, high = opened.scale(signal)
        assert low == pytest.approx(0.25 * whole[1], rel=0.02)
        assert high == pytest.approx(0.5 * whole[1], rel=0.02)
        assert opened.scale(verdicts) == pytest.approx([low, high], rel=1e-3)
        assert reset.is_visible()
        if back == "button":
            reset.click()
        else:
            opened.page.locator(f'[id="{signal}"] .u-over').dblclick()
        settle(opened.page)
        assert opened.scale(signal) == pytest.approx(whole)
        assert opened.scale(verdicts) == pytest.approx(whole, rel=1e-3)
        assert not reset.is_visible()
    assert opened.wrong == []


def test_a_look_into_one_figure_leaves_the_others(spiked: Path, open_page: Open) -> None:
    opened = open_page(spiked)
    whole = opened.scale("1-a-signal")
    opened.drag("1-a-nis", 0.5, 0.75)
    assert opened.scale("1-a-nis")[0] > 0.4 * whole[1]
    assert opened.scale("1-a-signal") == whole


def test_a_button_of_the_legend_hides_its_line(driven: Path, open_page: Open) -> None:
    opened = open_page(driven)
    figure = opened.page.evaluate("() => document.querySelector('figure').id")
    before = opened.pixels(figure, "readings")["all"]
    button = opened.page.locator(f'[id="{figure}"] .legend button').first
    assert "readings" in button.inner_text()
    button.click()
    settle(opened.page)
    assert button.get_attribute("aria-pressed") == "false"
    assert button.evaluate("(one) => getComputedStyle(one).opacity") == "1", "its name can be read still"
    assert opened.pixels(figure, "readings")["all"] < 0.05 * before
    button.click()
    settle(opened.page)
    assert opened.pixels(figure, "readings")["all"] == before


def test_a_spike_of_one_sample_is_seen_at_its_place(spiked: Path, open_page: Open) -> None:
    opened = open_page(spiked)
    found = opened.pixels("1-a-signal", "readings")
    of = f"(name) => {{ const {{ bbox }} = ({PLOT_OF})(name); return [bbox.left, bbox.width]; }}"
    left, width = opened.page.evaluate(of, "1-a-signal")
    place = left + width * SPIKE_ROW / (SPIKED_ROWS - 1)
    assert found["left"] - 2 <= place <= found["right"] + 2
    assert found["right"] - found["left"] <= 3


def test_the_dark_has_colours_of_its_own(driven: Path, open_page: Open) -> None:
    opened = open_page(driven)
    figure = opened.page.evaluate("() => document.querySelector('figure').id")
    page = opened.page
    colours = (
        "() => ['--paper', '--clean'].map((name) => getComputedStyle(document.documentElement).getPropertyValue(name))"
    )
    light, paper = page.evaluate(colours), page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    drawn = opened.pixels(figure, "clean")["all"]
    page.emulate_media(color_scheme="dark")
    settle(page)
    assert all(one != other for one, other in zip(light, page.evaluate(colours), strict=True))
    assert page.evaluate("() => getComputedStyle(document.body).backgroundColor") != paper
    assert opened.pixels(figure, "clean")["all"] == pytest.approx(drawn, rel=0.1), (
        "drawn anew in the colours of the dark"
    )


@pytest.mark.parametrize("width", [400, 1000])
def test_a_narrow_window_does_not_scroll_sideways(width: int, spiked: Path, driven: Path, open_page: Open) -> None:
    for path in (spiked, driven):
        opened = open_page(path, viewport={"width": width, "height": 800})
        assert opened.page.evaluate("() => document.documentElement.scrollWidth") <= width


def test_a_window_that_changes_draws_anew(driven: Path, open_page: Open) -> None:
    opened = open_page(driven)
    opened.page.set_viewport_size({"width": 700, "height": 900})
    settle(opened.page)
    canvas, place = opened.page.evaluate(
        "() => ['canvas', '.canvas'].map((one) => document.querySelector(`figure ${one}`).clientWidth)"
    )
    assert 600 < canvas <= place <= 700


def test_the_keyboard_reaches_every_button(spiked: Path, open_page: Open) -> None:
    opened = open_page(spiked)
    page = opened.page
    wanted = page.evaluate("() => [...document.querySelectorAll('button')].filter((one) => one.offsetParent).length")
    reached: set[str] = set()
    for _ in range(3 * wanted):
        page.keyboard.press("Tab")
        found = page.evaluate(
            "() => { const one = document.activeElement; return one.tagName === 'BUTTON' ?"
            " [one.closest('figure').id, one.innerText.trim(), getComputedStyle(one).outlineStyle] : null; }"
        )
        if found:
            assert found[1], "a button has a name"
            assert found[2] != "none", "what has the focus is seen"
            reached.add("|".join(found[:2]))
    assert len(reached) == wanted
    first = page.locator('[id="1-a-signal"] .legend button').first
    first.focus()
    page.keyboard.press("Space")
    assert first.get_attribute("aria-pressed") == "false"


def test_print_has_the_words_of_axes_as_text(spiked: Path, tmp_path: Path, open_page: Open) -> None:
    pytest.importorskip("matplotlib", reason="what is for print is drawn by matplotlib; install becalm[figures]")
    reader = shutil.which("pdftotext")
    if reader is None:
        pytest.skip("pdftotext reads what was printed: install Debian's poppler-utils")
    opened = open_page(spiked)
    opened.page.wait_for_function("() => [...document.querySelectorAll('[data-svg]')].every((one) => one.innerHTML)")
    opened.page.pdf(path=tmp_path / "r.pdf")
    text = subprocess.run(
        [reader, "-layout", tmp_path / "r.pdf", "-"], capture_output=True, text=True, check=True
    ).stdout
    for label in ("a (V)", "time since the first row (s)", "frequency (Hz)", "lag (rows)", "NIS"):
        assert label in text, label
    assert opened.wrong == []


def test_channels_of_hostile_names_are_drawn_and_run_nothing(tmp_path: Path, open_page: Open) -> None:
    script, image = "</script><script>window.ran = 1</script>", '"><img src=x onerror="window.ran = 1">'
    names = [script, image, "ä 加速度", "b" * 300]
    values = np.random.default_rng(3).normal(size=(400, 4))
    values[:, 3] = 1e9 + 1e-3 * values[:, 3]
    opened = open_page(written(tmp_path, Recording(values, names=names, rate_hz=100.0)))
    assert opened.wrong == []  # before pixels are counted, of which Chromium warns
    assert len(opened.asked) == 1
    assert opened.page.evaluate("() => window.ran === undefined")
    headings = opened.page.locator("h2").all_inner_texts()
    assert headings == names
    for figure in opened.page.evaluate("() => [...document.querySelectorAll('figure')].map((one) => one.id)"):
        if figure.endswith("-signal"):
            assert opened.pixels(figure, "readings")["all"] > 20
    assert opened.page.evaluate("() => document.documentElement.scrollWidth") <= 1300


def test_readings_between_missing_ones_are_seen(tmp_path: Path, open_page: Open) -> None:
    z = np.cumsum(np.random.default_rng(8).normal(0, 0.1, 4000))
    z += np.random.default_rng(9).normal(0, 0.5, 4000)
    z[::2] = np.nan
    opened = open_page(written(tmp_path, Recording(z, names=["a"], rate_hz=100.0)))
    assert opened.pixels("1-a-closeup-1", "readings")["all"] > 300
    assert opened.wrong == []


def test_numbers_beside_an_axis_differ_and_have_room(tmp_path: Path, open_page: Open) -> None:
    rng = np.random.default_rng(7)
    z = np.cumsum(rng.normal(0, 0.1, 4000)) + rng.normal(0, 0.5, 4000)
    odd = [(0.0, 1e-12), (1e9, 1.0), (-1e9, 1e-3), (0.0, 1e20), (3.0, 1e-5)]
    values, units = np.column_stack([offset + scale * z for offset, scale in odd]), ["V"] * len(odd)
    opened = open_page(written(tmp_path, Recording(values, names=list("abcde"), units=units, rate_hz=1e5)))
    for number, name in enumerate("abcde", 1):
        for figure, axis in itertools.product((f"{number}-{name}-signal", f"{number}-{name}-closeup-1"), (0, 1)):
            places, told, room = opened.page.evaluate(TICKS.replace("plotOf", f"({PLOT_OF})"), [figure, axis])
            assert len(told) > 2
            step = places[1] - places[0]
            assert [float(one) for one in told] == pytest.approx(places, rel=0, abs=0.01 * step), told
            assert room > 0 or axis == 0, told
    assert opened.wrong == []
