"""Make the report on a fleet: one self-contained HTML page with a row for each channel, the worst first."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

from jinja2 import Environment

from becalm.installation import version
from becalm.report.embedding import asset, packed, script
from becalm.report.fleet.fleet_order import TRAITS, summary, worst_first
from becalm.report.fleet.fleet_rows import FleetRow, spaced

_CSS_CLASSES = {  # CSS classes of properties in `TRAITS`; other properties have none
    "refused": "not",
    "does not fit": "not",
    "faulty": "not",
    "outlying": "except",
    "fits except": "except",
    "sigma doubtful": "except",
    "fits": "fits",
}
_TEXT_COLUMNS = ("sensor", "channel", "unit", "reason", "faults", "says", "recipe", "outlying")
_NUMBER_COLUMNS = ("health", "noise_std", "rate_hz")
_STYLES = ("figures.css", "page.css", "fleet/fleet.css")
_SCRIPTS = ("colours.js", "numbers.js", *(f"fleet/{name}.js" for name in ("rows", "table", "strip", "main")))
_MOST_NAMED = 6  # largest number of recipes that the page lists by name


@dataclass(frozen=True)
class FleetFacts:
    """Facts about a fleet for the head of its report.

    Attributes
    ----------
    lake, output : str
        Paths that were read and written.
    began : str
        Start time in ISO 8601; empty to leave it out of the report.
    took_s : float or None
        Duration of the run in seconds.
    rows_total : int
        Number of rows of all sensors together.
    recipes : tuple of str
        Names of the recipes that were used.
    done : str
        What was done to the sensors, as a participle: "cleaned" or "tuned".
    """

    lake: str
    output: str
    began: str = ""
    took_s: float | None = None
    rows_total: int = 0
    recipes: tuple[str, ...] = ()
    done: str = "cleaned"


class _Filter(NamedTuple):
    """A button that shows only the rows with one property."""

    name: str
    says: str
    tone: str
    rows: str  # number of such rows, as text
    bit: int  # index of the property in `TRAITS`


def fleet_page(rows: Sequence[FleetRow], facts: FleetFacts) -> str:
    """Return the report on a cleaned fleet, as HTML.

    Parameters
    ----------
    rows : sequence of FleetRow
        A row for each channel of each sensor, in any order.
    facts : FleetFacts
        Facts about the fleet.
    """
    sorted_rows = worst_first(rows)
    return (
        Environment(autoescape=True)
        .from_string(asset("fleet/fleet.html"))
        .render(
            name=_page_text(facts.lake),
            version=version(),
            lead=_page_text(summary(rows, facts.done)),
            fact_lines=_fact_lines(facts),
            filters=_filters(sorted_rows),
            total=_page_text(spaced(len(sorted_rows))),
            rows=packed(_columns(sorted_rows).encode()),
            css="".join(asset(name) for name in _STYLES),
            js=script(*_SCRIPTS),
        )
    )


def _page_text(text: str) -> str:
    """Replace characters that UTF-8 cannot encode, and spaces between digit groups (10 000) by no-break spaces."""
    encodable = text.encode("utf-8", "replace").decode()
    return re.sub(r"(?<=\d) (?=\d{3}\b)", "\u202f", encodable)


def _fact_lines(facts: FleetFacts) -> list[tuple[str, str]]:
    recipes = ", ".join(facts.recipes[:_MOST_NAMED])
    more = len(facts.recipes) - _MOST_NAMED
    lines = [
        ("written to", facts.output),
        ("began", _time_text(facts.began)),
        ("took", _duration_text(facts.took_s)),
        ("rows", spaced(facts.rows_total)),
        ("recipes" if len(facts.recipes) > 1 else "recipe", f"{recipes} and {more} more" if more > 0 else recipes),
    ]
    return [(term, _page_text(one)) for term, one in lines if one]


def _time_text(began: str) -> str:
    """Return a time in ISO 8601 as a text with minutes, or the text unchanged if it is not a time."""
    try:
        return f"{datetime.fromisoformat(began):%Y-%m-%d %H:%M %Z}".strip()
    except ValueError:
        return began


def _duration_text(took_s: float | None) -> str:
    """Return a duration in words."""
    if took_s is None:
        return ""
    if took_s < 60:
        return f"{took_s:.3g} s"
    minutes, seconds = divmod(round(took_s), 60)
    return f"{minutes} min {seconds} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def _filters(rows: Sequence[FleetRow]) -> list[_Filter]:
    """Return a button for each property that at least one row has, with the number of such rows."""
    counts = [sum(trait.holds(row) for row in rows) for trait in TRAITS]
    return [
        _Filter(trait.name, trait.says, _CSS_CLASSES.get(trait.name, ""), _page_text(spaced(count)), bit)
        for bit, (trait, count) in enumerate(zip(TRAITS, counts, strict=True))
        if count
    ]


def _columns(rows: Sequence[FleetRow]) -> str:
    """Return rows as JSON, one array for each column; unknown values are null."""
    columns: dict[str, list[object]] = {name: [getattr(row, name) for row in rows] for name in (*_TEXT_COLUMNS, "rows")}
    columns |= {name: [_rounded(getattr(row, name)) for row in rows] for name in _NUMBER_COLUMNS}
    columns["usable"] = [_percent_down(row.usable_share) for row in rows]
    columns["traits"] = [sum(trait.holds(row) << bit for bit, trait in enumerate(TRAITS)) for row in rows]
    traits = [{"name": trait.name, "tone": _CSS_CLASSES.get(trait.name, "")} for trait in TRAITS]
    return json.dumps({"traits": traits, "columns": columns}, separators=(",", ":"), allow_nan=False)


def _rounded(value: float | None) -> float | None:
    """Return a number rounded to six digits, more than the page shows; None if JSON cannot represent it."""
    return float(f"{value:.6g}") if value is not None and math.isfinite(value) else None


def _percent_down(share: float | None) -> float | None:
    """Return a share in percent, rounded down to hundredths, so that only a share of 1 is 100 %; None if unknown."""
    return math.floor(share * 1e4 + 1e-9) / 100 if share is not None and math.isfinite(share) else None
