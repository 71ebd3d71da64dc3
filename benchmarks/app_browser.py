"""Measure in Chromium how long the tuner takes from a turn of its dial until the canvas shows the new picture."""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median

import numpy as np

import becalm
from app_runs import CHROMIUM, QUIET, tuner

RATE_HZ = 10_000.0
TURN = """async (count) => {
  const dial = document.getElementById("dial"), took = [];
  let drawn = () => {};
  becalm.plot.u.hooks.draw.push(() => drawn());
  for (let i = 0; i < count; i += 1) {
    const before = becalm.desk.pictures;
    dial.value = String(20 + (i % 20));
    const begun = performance.now();
    dial.dispatchEvent(new Event("input"));
    await new Promise((done) => { drawn = () => { if (becalm.desk.pictures > before) done(); }; });
    took.push(performance.now() - begun);
    await new Promise(requestAnimationFrame);
  }
  return took;
}"""
IDLE = "() => becalm.asking.pending === null && becalm.asking.waiting.size === 0"
JUDGED = "() => /^[✓!✗]/.test(document.querySelector('#verdict').textContent)"


def drawn_ms(rows: int, repeats: int) -> dict[str, list[float]]:
    """Measure the time from a turn of the dial until the canvas is drawn, in milliseconds.

    Parameters
    ----------
    rows : int
        Number of rows of the record, at 10 kHz.
    repeats : int
        Number of turns in each view.

    Returns
    -------
    dict of str to list of float
        Times of all turns by view; the screen shows the canvas with its next frame.
    """
    from playwright.sync_api import sync_playwright

    rng = np.random.default_rng(3)
    z = np.cumsum(rng.normal(0, 2e-3, rows)) + rng.normal(0, 0.3, rows)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "files"
        folder.mkdir()
        becalm.write(folder / "long.npz", becalm.Recording(z, names=["a"], units=["V"], rate_hz=RATE_HZ))
        with tuner(folder, str(folder / "long.npz")) as app, sync_playwright() as playwright:
            chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
            page = chromium.new_page(viewport={"width": 1400, "height": 900})
            page.set_default_timeout(300_000)
            page.goto(app.url)
            page.wait_for_function("() => window.becalm?.desk.pictures > 0 && becalm.dial.positions")
            found = {}
            for view, look in (("whole", "becalm.plot.whole()"), ("1 s", "becalm.plot.look(50, 51)")):
                page.wait_for_function(JUDGED)  # the figures of the report must not slow down the turns
                page.evaluate(f"() => {{ {look}; }}")
                page.wait_for_function(IDLE)
                found[view] = list(page.evaluate(TURN, repeats))
                page.wait_for_function(IDLE)
            chromium.close()
            return found


def in_browser(rows: int, repeats: int) -> str:
    """Measure, and return a table; without a browser, return a sentence."""
    if CHROMIUM is None:
        return "There is no Chromium on this machine to look at the page with.\n"
    table = ["| in the browser | median, ms | longest, ms |", "|---|---|---|"]
    for view, took in drawn_ms(rows, repeats).items():
        table.append(f"| {view} | {median(took):.0f} | {max(took):.0f} |")
    return "\n".join([*table, ""])
