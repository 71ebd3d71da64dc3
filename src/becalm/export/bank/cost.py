"""What a row of a filter with loops costs: operations counted in its C, each as often as it runs."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fractions import Fraction

from becalm.export.expressions import Cost, cost_of

_FUNCTION = re.compile(r"^(?:static )?\w+ (\w+)\([^;]*?\)\n\{\n(.*?)^\}", re.M | re.S)
_LOOP = re.compile(r"for \(uint32_t \w = 0u; \w (<=?) (\w+?)u?;")
_WHOLE = re.compile(r"\b(uint32_t|uint64_t) \w+ =|\bbits\b")


def row_cost(source: str, names: Iterable[str]) -> Cost:
    """Return what functions cost together, with all that they call.

    Parameters
    ----------
    source : str
        C: one statement a line, braces at the ends of lines, loops from 0 to a number, or to the counter around them.
    names : iterable of str
        Of the functions; one that the source has not costs nothing.

    Notes
    -----
    Of two branches both are counted: it is the most that a row costs. Arithmetic of whole numbers, comparisons and
    copies are not.
    """
    bodies = dict(_FUNCTION.findall(source))
    multiplications, additions, divisions = _total(bodies, [name for name in names if name in bodies])
    return Cost(int(multiplications), int(additions), int(divisions))


def _total(bodies: dict[str, str], names: Iterable[str]) -> list[Fraction]:
    costs = [_cost_of_function(bodies, name) for name in names]
    return [sum(each, Fraction(0)) for each in zip(*costs, strict=True)]


def _cost_of_function(bodies: dict[str, str], name: str) -> list[Fraction]:
    """Count a function: each line times the loops that it stands in."""
    found, times = [Fraction(0)] * 3, [Fraction(1)]
    for line in bodies[name].splitlines():
        loop, opens, closes = _LOOP.search(line), line.count("{"), line.count("}")
        if closes > opens or line.strip().startswith("}"):
            times.pop()
        if loop is None and not _WHOLE.search(line):
            called = [word for word in re.findall(r"(\w+)\(", line) if word in bodies]
            own = [cost_of([line]), *(_cost_of_function(bodies, word) for word in called)]
            found = [count + times[-1] * sum(each) for count, each in zip(found, zip(*own, strict=True), strict=True)]
        if opens > closes or (opens and line.strip().startswith("}")):
            times.append(times[-1] * _runs(loop, times))
    return found


def _runs(loop: re.Match[str] | None, times: list[Fraction]) -> Fraction:
    """Return how often a block runs each time that it is met; one up to the counter around it, on the average."""
    if loop is None:
        return Fraction(1)
    if loop[2].isdigit():
        return Fraction(int(loop[2]))
    around = times[-1] / times[-2]
    return (around + 1) / 2 if loop[1] == "<=" else (around - 1) / 2
