"""The tuner as a person has it: becalm's own command, and a browser that looks at it and takes notes."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

from app_runs import CHROMIUM, QUIET, App
from becalm.core.recording import Recording
from becalm.files.outputs.writing import write

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

SCREENSHOTS = Path(__file__).parents[2] / "build" / "screenshots"
PATIENCE_MS = 60_000
ROWS, RATE_HZ = 12_000, 100.0

OWN_DOING = "Multiple readback operations"  # what Chromium says where pixels are counted
IDLE = "() => becalm.asking.pending === null && becalm.asking.waiting.size === 0"
BUTTON = "button, input, select, summary, [tabindex='0']"
NAMELESS = f"""() => [...document.querySelectorAll("{BUTTON}")].filter((one) => one.offsetParent && !(
  one.innerText.trim() || one.getAttribute("aria-label") || one.labels?.length)).map((one) => one.outerHTML)"""
HELD = """([name, text]) => {
  const held = new DataTransfer();
  held.items.add(new File([text], name));
  return held;
}"""
FOCUSED = """() => {
  const one = document.activeElement;
  return [one.getAttribute("aria-label") || one.innerText.trim(), getComputedStyle(one).outlineStyle];
}"""
PIXELS = """(role) => {
  const canvas = document.querySelector("#plot .canvas canvas");
  const { data, width } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const probe = document.createElement("i");
  probe.style.color = getComputedStyle(document.documentElement).getPropertyValue(`--${role}`);
  document.body.append(probe);
  const [r, g, b] = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
  probe.remove();
  const found = { all: 0, sum: 0, top: canvas.height, left: width, right: -1 };
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] === 0) continue;
    if (Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) > 12) continue;
    const [x, y] = [(i / 4) % width, Math.floor(i / 4 / width)];
    found.all += 1;
    found.sum = (found.sum * 31 + i) % 1000003;
    if (y < found.top) Object.assign(found, { top: y, left: x, right: x });
    else if (y === found.top) found.right = x;
  }
  return found;
}"""


class Visit(NamedTuple):
    """A browser's window on the tuner, and what went wrong there."""

    page: Page
    wrong: list[str]
    foreign: list[str]

    def open(self, app: App) -> None:
        """Open the page, and wait until becalm has said which files there are: then the list is shown, or not."""
        self.page.goto(app.url)
        self.page.wait_for_function("() => document.body.dataset.state === 'open' && window.becalm?.desk.run")

    def open_file(self, app: App, name: str) -> None:
        """Open a file of the folder, as a person does; one that is open comes by itself."""
        if app.shows == name:
            self.opened(name)
            return
        app.shows = name
        if not self.page.locator("#files").is_visible():
            self.page.locator("#show-files").click()
        self.page.locator("#folder button", has_text=name).click()
        self.opened(name)

    def opened(self, name: str) -> None:
        """Wait until a file is there, with its picture."""
        self.page.wait_for_function("(name) => becalm.desk.recording?.name === name && becalm.desk.state", arg=name)
        self.page.wait_for_function("() => becalm.desk.pictures > 0 && becalm.dial.positions")
        self.idle()

    def idle(self) -> None:
        """Wait until what was asked is drawn."""
        self.page.wait_for_function(IDLE)
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def judged(self) -> None:
        self.page.wait_for_function("() => document.querySelectorAll('#figures figure .u-wrap').length >= 4")
        self.page.wait_for_function("() => !document.querySelector('#figures.stale') && becalm.map.u")
        self.idle()

    def settings(self, channel: int = 0) -> dict[str, Any]:
        found: dict[str, Any] = self.page.evaluate(f"() => becalm.desk.state.channels[{channel}]")
        return found

    def changed(self, before: dict[str, Any]) -> dict[str, Any]:
        """Wait until channel 0 is set otherwise; return how."""
        self.page.wait_for_function("(old) => JSON.stringify(becalm.desk.state.channels[0]) !== old", arg=_json(before))
        self.idle()
        return self.settings()

    def view(self) -> tuple[float, float]:
        self.idle()
        view = self.page.evaluate("() => becalm.plot.view")
        return view["from"], view["to"]

    def pixels(self, role: str) -> dict[str, int]:
        self.idle()
        found: dict[str, int] = self.page.evaluate(PIXELS, role)
        return found

    def draws(self, role: str, wanted: dict[str, int]) -> bool:
        """Whether a picture comes that is as wanted; of what was taken back it comes after the settings."""
        deadline = time.monotonic() + PATIENCE_MS / 1000
        while self.pixels(role) != wanted and time.monotonic() < deadline:
            self.page.wait_for_timeout(50)
        return self.pixels(role) == wanted

    def over(self) -> tuple[float, float, float, float]:
        """Where the plot's frame is: left, top, width, height."""
        over = self.page.locator("#plot .u-over")
        over.scroll_into_view_if_needed()
        box = over.bounding_box()
        assert box is not None
        return box["x"], box["y"], box["width"], box["height"]

    def save(self, button: str, folder: Path) -> Path:
        with self.page.expect_download() as held:
            self.page.locator(f"#{button}").click()
        path = folder / held.value.suggested_filename
        held.value.save_as(path)
        return path

    def drop(self, path: Path) -> None:
        """Drop a file on the page."""
        text = path.read_text(encoding="utf-8")
        self.page.dispatch_event("body", "drop", {"dataTransfer": self.page.evaluate_handle(HELD, [path.name, text])})

    def forgive_silence(self) -> None:
        """Forget what was said of the wire while nobody was at its other end."""
        self.wrong[:] = [said for said in self.wrong if "WebSocket connection" not in said]

    def walk_to(self, name: str) -> None:
        """Press Tab until what has that name has the focus, and shows it."""
        for _ in range(80):
            label, outline = self.page.evaluate(FOCUSED)
            if label == name:
                assert outline != "none", "what has the focus is seen"
                return
            self.page.keyboard.press("Tab")
        raise AssertionError(f"Tab does not lead to {name}")

    def shoot(self, name: str) -> None:
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)


Look = Callable[..., Visit]


def _json(value: dict[str, Any]) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


@contextmanager
def visiting(browser: Browser, base: str, **more: Any) -> Iterator[Visit]:
    """Look through a window that reaches becalm and nothing else."""
    context = browser.new_context(**{"viewport": {"width": 1400, "height": 900}, **more})
    page, wrong, foreign = context.new_page(), [], []
    page.set_default_timeout(PATIENCE_MS)

    def refuse(route: Route) -> None:
        foreign.append(route.request.url)
        route.abort()

    def note(kind: str, text: str) -> None:
        if kind in ("error", "warning") and OWN_DOING not in text:
            wrong.append(text)

    context.route(lambda url: not url.startswith((base, "blob:", "data:")), refuse)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda said: note(said.type, said.text))
    try:
        yield Visit(page, wrong, foreign)
    finally:
        context.close()


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start a browser; without one the test is skipped on a person's machine, and fails in CI."""
    if CHROMIUM is None and os.environ.get("CI"):
        pytest.fail("CI needs a browser: install Debian's chromium")
    if CHROMIUM is None:
        pytest.skip("a browser looks at the page: install Debian's chromium")
    driver = pytest.importorskip("playwright.sync_api", reason="a browser looks at the page: pip install playwright")
    with driver.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield started
        started.close()


@contextmanager
def looking(browser: Browser) -> Iterator[Look]:
    """Look at tuners through new windows; whatever goes wrong in one fails the test."""
    with ExitStack() as stack:
        visits = []

        def at(app: App, name: str = "drive.parquet", **more: Any) -> Visit:
            visit = stack.enter_context(visiting(browser, app.base, **more))
            visits.append(visit)
            visit.open(app)
            if name:
                visit.open_file(app, name)
            return visit

        yield at
        for visit in visits:
            assert visit.wrong == []
            assert visit.foreign == []


def drive(path: Path) -> Path:
    """Write two channels: a motion with a tone and a few spikes, and a slower one with a gap."""
    rng = np.random.default_rng(9)
    t = np.arange(ROWS) / RATE_HZ
    speed = np.cumsum(np.cumsum(rng.normal(0, 2e-3, ROWS))) / 10 + 0.6 * np.sin(2 * np.pi * 17.0 * t)
    speed += rng.normal(0, 0.4, ROWS)
    speed[[2000, 5200, 9100]] += 25.0
    tilt = 5 * np.sin(2 * np.pi * t / 40) + rng.normal(0, 0.5, ROWS)
    tilt[6000:6300] = np.nan
    values = np.column_stack([speed, tilt])
    write(path, Recording(values, names=["speed", "tilt"], units=["m/s", "deg"], rate_hz=RATE_HZ))
    return path
