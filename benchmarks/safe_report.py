"""Make the tables of `safe.py`: totals for each bound, violations, and the largest errors of all cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from safe_bounds import LIMITS, OFTEN

_SHOWN = 25


class Result(NamedTuple):
    """The measures of one case; `says` is the message of an exception, or ""."""

    signal: str
    insult: str
    estimate: str
    path: str
    measured: Mapping[str, float]
    says: str

    @property
    def name(self) -> str:
        """Return the description of the case."""
        return f"{self.signal}, {self.insult}, {self.estimate}, {self.path}"


def measured(results: Sequence[Result], bound: str) -> list[tuple[float, Result]]:
    """Return the values of a measure with their cases, the largest first; cases without this measure are left out."""
    default = 0.0 if bound == "raised" else np.nan
    found = [(one.measured.get(bound, default), one) for one in results]
    return sorted((pair for pair in found if not np.isnan(pair[0])), key=lambda pair: -pair[0])


def totals(results: Sequence[Result]) -> list[str]:
    """Return a table of the number of cases beyond each bound."""
    lines = ["| bound | at most | cases | beyond | share | median | worst |", "|---|---|---|---|---|---|---|"]
    for bound, limit in LIMITS.items():
        lines.append(_total(bound, limit, measured(results, bound)))
        if bound == "away":
            lines.append(_total("away, in 95 %", OFTEN, measured(results, bound)))
    return lines


def _total(bound: str, limit: float, found: Sequence[tuple[float, Result]]) -> str:
    """Return one row of the totals."""
    if not found:
        return f"| {bound} | {limit:g} | 0 | | | | |"
    values = np.array([value for value, _ in found])
    beyond = int(np.count_nonzero(values > limit))
    return (
        f"| {bound} | {limit:g} | {len(values)} | {beyond} | {beyond / len(values):.1%} | {np.median(values):.3g}"
        f" | {values[0]:.3g} |"
    )


def by_insult(results: Sequence[Result]) -> list[str]:
    """Return a table of the number of cases beyond each bound, by insult."""
    insults = list(dict.fromkeys(one.insult for one in results))
    lines = [f"| insult | cases | {' | '.join(LIMITS)} |", "|---|---" + "|---" * len(LIMITS) + "|"]
    for insult in insults:
        of = [one for one in results if one.insult == insult]
        counts = [sum(value > limit for value, _ in measured(of, bound)) for bound, limit in LIMITS.items()]
        lines.append(f"| {insult} | {len(of)} | {' | '.join(str(count or '') for count in counts)} |")
    return lines


def violations(results: Sequence[Result], every: bool) -> list[str]:
    """Return a list of the cases that are beyond each bound, the worst first."""
    lines = []
    for bound, limit in LIMITS.items():
        beyond = [(value, one) for value, one in measured(results, bound) if value > limit]
        if not beyond:
            continue
        lines += ["", f"### {bound[0].upper()}{bound[1:]}: {len(beyond)} beyond {limit:g}", ""]
        shown = beyond if every else beyond[:_SHOWN]
        lines += [f"- {value:.3g}: {one.name}{': ' if one.says else ''}{one.says}" for value, one in shown]
        if len(beyond) > len(shown):
            lines.append(f"- and {len(beyond) - len(shown)} more")
    return lines


def grid(results: Sequence[Result], bound: str) -> list[str]:
    """Return a table of one measure in all cases of one estimate and path."""
    signals = list(dict.fromkeys(one.signal for one in results))
    cases = {(one.signal, one.insult): one.measured.get(bound, np.nan) for one in results}
    lines = [f"| insult | {' | '.join(signals)} |", "|---" * (len(signals) + 1) + "|"]
    for insult in dict.fromkeys(one.insult for one in results):
        cells = [_cell(cases.get((signal, insult), np.nan), LIMITS.get(bound, np.inf)) for signal in signals]
        lines.append(f"| {insult} | {' | '.join(cells)} |")
    return lines


def _cell(value: float, limit: float) -> str:
    """Return a number, bold if it is beyond its bound; "" for NaN."""
    if np.isnan(value):
        return ""
    return f"**{value:.2g}**" if value > limit else f"{value:.2g}"


def page(results: Sequence[Result], every: bool) -> str:
    """Return the whole page.

    Parameters
    ----------
    results : sequence of Result
        Results of all cases.
    every : bool
        Whether to list every violation.
    """
    results = sorted(results, key=lambda one: one.path)  # C, file, live; stable otherwise
    unknown = np.array([value for value, _ in measured(results, "NaN inside")])
    said = f"{unknown.mean():.1%} of the hidden rows are NaN, mean over cases." if len(unknown) else ""
    lines = ["## Bounds", "", *totals(results), "", said, "", "## Beyond, by insult", "", *by_insult(results)]
    lines += ["", "## Violations", *violations(results, every)]
    for path, estimate in dict.fromkeys((one.path, one.estimate) for one in results):
        of = [one for one in results if (one.path, one.estimate) == (path, estimate)]
        for bound in ("largest error", "away", "inside"):
            lines += ["", f"## {bound[0].upper()}{bound[1:]}: {path}, {estimate}", "", *grid(of, bound)]
    return "\n".join(lines) + "\n"
