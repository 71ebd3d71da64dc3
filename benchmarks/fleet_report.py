"""How fast the report on a fleet opens and reacts, in Chromium without a graphics card.

The fleet is simulated. Each sensor has its own innovations, which becalm judges like those of a recording: most are
white, some are coloured, have a tone, or have another variance than predicted. A few sensors are faulty, outlying or
refused.

*Opens* is the time from the start of the navigation to the page's file until the frame with the first rows is painted,
each time in a browser context with an empty cache. *Answers* is the time from a click on a filter, a change of the
search or a click on a heading until the frame with the result is painted: for all filters, six searches, and all
headings in both directions. Medians are given, and the longest times in brackets.

Run: python benchmarks/fleet_report.py [--sensors 10000] [--repeats 7] [-o docs/fleet-report.md]
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from app_runs import CHROMIUM, QUIET
from becalm.cleaning.channels.faults import Fault
from becalm.cleaning.channels.judging import InnovationJudge, Judgement
from becalm.report.fleet.fleet_page import FleetFacts, fleet_page
from becalm.report.fleet.fleet_rows import FleetRow, faults_text
from pages import page_parser, publish

if TYPE_CHECKING:
    from playwright.sync_api import Browser

MOST_OPENS_MS, MOST_ANSWERS_MS, MOST_BYTES = 1000.0, 100.0, 1_000_000
"""Required of a page of 10 000 sensors: times in milliseconds, and bytes."""

_INNOVATIONS, _ROWS, _RATE_HZ = 600, 8_640_000, 100.0
_CLASSES = (("vibration", "m/s^2", 0.02), ("strain", "um/m", 0.8), ("load", "kN", 0.35))
_PAINTED = "(done) => requestAnimationFrame(() => setTimeout(done))"
_OPENED = f"""new MutationObserver((_, observer) => {{
  if (!document.querySelector("#table tbody td")) return;
  observer.disconnect();
  ({_PAINTED})(() => {{ window.openedAt = performance.now(); }});
}}).observe(document, {{ childList: true, subtree: true }})"""
_ANSWERS = f"""async () => {{
  const painted = () => new Promise({_PAINTED});
  const took = {{ filter: [], search: [], heading: [] }};
  const time = async (kind, act) => {{
    await painted();
    const begun = performance.now();
    act();
    await painted();
    took[kind].push(performance.now() - begun);
  }};
  for (const one of document.querySelectorAll("[data-bit]")) await time("filter", () => one.click());
  document.querySelector("[data-bit='-1']").click();
  const search = document.getElementById("search");
  for (const words of ["s", "se", "sensor=00017", "clipped", "plant=3 fits", ""])
    await time("search", () => {{ search.value = words; search.dispatchEvent(new Event("input")); }});
  for (const one of [...document.querySelectorAll("th button")].flatMap((one) => [one, one]))
    await time("heading", () => one.click());
  return took;
}}"""


class Timed(NamedTuple):
    """The times of a page, in milliseconds."""

    opens: list[float]
    answers: dict[str, list[float]]


def simulated(sensors: int, seed: int = 5) -> list[FleetRow]:
    """Return the rows of a fleet, with one channel per sensor, in the order of their names."""
    rng = np.random.default_rng(seed)
    return [_row(number, rng) for number in range(sensors)]


def facts_of(rows: list[FleetRow]) -> FleetFacts:
    """Return facts about a simulated fleet."""
    names = tuple(name for name, _, _ in _CLASSES)
    return FleetFacts("lake", "cleaned", "2026-03-01T06:00:00+00:00", 5025.0, sum(row.rows for row in rows), names)


def _row(number: int, rng: np.random.Generator) -> FleetRow:
    channel, unit, usual_std = _CLASSES[number % len(_CLASSES)]
    sensor = f"plant={number % 7 + 1}/line={number % 23 + 1}/sensor={number:05d}"
    kind = rng.random()
    if kind < 0.001:
        reason = f"{sensor} has no row whose time is known; see its column time, or say which it is: --time NAME."
        return FleetRow(sensor, state="refused", reason=reason)
    judgement = _judged(kind, rng)
    outlying = kind > 0.996
    noise_std = usual_std * float(rng.lognormal(0, 0.08)) * (float(rng.uniform(3, 12)) if outlying else 1.0)
    faults = _faults(rng) if rng.random() < 0.02 else ()
    row = FleetRow(
        sensor,
        channel,
        unit,
        verdict=judgement.verdict,
        health=judgement.nis_mean,
        noise_std=noise_std,
        usable_share=1 - sum(fault.readings for fault in faults) / _ROWS,
        faults=faults_text(faults),
        says=judgement.says,
        recipe=f"{int(rng.integers(1 << 48)) if number % 97 == 0 else 0xC0FFEE00 + number % 3:012x}",
        rows=_ROWS - int(rng.integers(200)),
        rate_hz=_RATE_HZ,
    )
    remark = f"Its noise is {noise_std / usual_std:.2g} times that of {channel} elsewhere." if outlying else ""
    return replace(row, outlying=remark)


def _judged(kind: float, rng: np.random.Generator) -> Judgement:
    """Judge innovations that are white, coloured, with a tone, or of another variance than predicted."""
    innovations = rng.normal(size=_INNOVATIONS)
    if kind < 0.004:
        innovations[1:] += 0.8 * innovations[:-1]
    elif kind < 0.02:
        innovations += 0.7 * np.sin(0.8 * np.arange(_INNOVATIONS))
    judge = InnovationJudge(1 / _RATE_HZ)
    judge.add(innovations, 0.6 if 0.02 < kind < 0.025 else 1.0)
    return judge.judgement()


def _faults(rng: np.random.Generator) -> tuple[Fault, ...]:
    kinds = [what for what in ("spike", "clipped", "stuck", "gap") if rng.random() < 0.5]
    return tuple(Fault(what, int(rng.integers(1, 40_000)), 1, 0.0, 0.0) for what in kinds)


def timed(browser: Browser, path: Path, repeats: int) -> Timed:
    """Open a page `repeats` times, and operate all its controls."""
    opens: list[float] = []
    answers: dict[str, list[float]] = {}
    for _ in range(repeats):
        context = browser.new_context(offline=True, viewport={"width": 1400, "height": 900})
        context.add_init_script(_OPENED)
        page = context.new_page()
        page.goto(path.as_uri())
        page.wait_for_function("() => window.openedAt")
        opens.append(page.evaluate("() => window.openedAt"))
        for kind, took in page.evaluate(_ANSWERS).items():
            answers.setdefault(kind, []).extend(took)
        context.close()
    return Timed(opens, answers)


def table(sensors: int, repeats: int) -> str:
    """Measure, and return the table; without a browser, return a sentence."""
    if CHROMIUM is None:
        return "There is no Chromium on this machine to open the page with.\n"
    from playwright.sync_api import sync_playwright

    lines = [
        f"Opened {repeats} times each. Asked, of 10,000 sensors: opens within {MOST_OPENS_MS:g} ms, answers within"
        f" {MOST_ANSWERS_MS:g} ms, under {MOST_BYTES:,} bytes.",
        "",
        "| sensors | page, bytes | opens, ms | filter, ms | search, ms | heading, ms |",
        "|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        rows = simulated(sensors)
        for count in (sensors // 10, sensors):
            path = Path(name) / f"{count}.html"
            path.write_text(fleet_page(rows[:count], facts_of(rows[:count])), encoding="utf-8")
            found = timed(browser, path, repeats)
            took = (found.opens, *(found.answers[kind] for kind in ("filter", "search", "heading")))
            cells = " | ".join(f"{median(one):.0f} ({max(one):.0f})" for one in took)
            lines.append(f"| {count:,} | {path.stat().st_size:,} | {cells} |")
        browser.close()
    return "\n".join([*lines, ""])


def main() -> None:
    """Print the table; with -o, write it as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("--sensors", type=int, default=10_000, help="of the fleet")
    parser.add_argument("--repeats", type=int, default=7, help="how often it is opened")
    arguments = parser.parse_args()
    publish("How soon a fleet's report opens", __doc__, table(arguments.sensors, arguments.repeats), arguments.output)


if __name__ == "__main__":
    main()
