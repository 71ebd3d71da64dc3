"""What a row of a filter with loops costs: operations counted in its C, each as often as it runs."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from fractions import Fraction
from typing import NamedTuple

from becalm.export.expressions import Cost, cost_of

_FUNCTION = re.compile(r"^(?:static )?\w+ (\w+)\([^;]*?\)\n\{\n(.*?)^\}", re.M | re.S)
_LOOP = re.compile(r"for \((?:uint32_t|size_t) \w+ = 0u; (?:\w+ && \()?\w+ (<=?) (\w+?)u?\)?;")
_WHOLE = re.compile(r"\b(uint32_t|uint64_t|size_t) \w+ =|\bbits\b")
_WHOLE_TERM = re.compile(r" [+-] \d+u\b|\b\d+u [+-] \w+")


class _Counted(NamedTuple):
    """What is counted: bodies by their functions, and how often loops of a function run up to what it is given."""

    bodies: dict[str, str]
    turns: Mapping[str, int]


def row_cost(
    source: str, names: Iterable[str], *, turns: Mapping[str, int] | None = None, never: Collection[str] = ()
) -> Cost:
    """Return what functions cost together, with all that they call.

    Parameters
    ----------
    source : str
        C: one statement a line, braces at the ends of lines, loops from 0 to a number, to the counter around them, or
        to what the function is given.
    names : iterable of str
        Of the functions; one that the source has not costs nothing.
    turns : mapping of str to int
        How often loops run that go to what a function is given, by its name.
    never : collection of str
        Functions that such a row does not call.

    Notes
    -----
    Of two branches both are counted: it is the most that a row costs. Arithmetic of whole numbers, comparisons and
    copies are not.
    """
    bodies = {name: body for name, body in _FUNCTION.findall(source) if name not in never}
    called = [name for name in names if name in bodies]
    multiplications, additions, divisions = _total(_Counted(bodies, turns or {}), called)
    return Cost(int(multiplications), int(additions), int(divisions))


def _total(counted: _Counted, names: Iterable[str]) -> list[Fraction]:
    costs = [_cost_of_function(counted, name) for name in names]
    return [sum(each, Fraction(0)) for each in zip(*costs, strict=True)]


def _cost_of_function(counted: _Counted, name: str) -> list[Fraction]:
    """Count a function: each line times the loops that it stands in."""
    bodies, given = counted.bodies, counted.turns.get(name)
    found, times = [Fraction(0)] * 3, [Fraction(1)]
    for line in bodies[name].splitlines():
        loop, opens, closes = _LOOP.search(line), line.count("{"), line.count("}")
        if loop is None and line.lstrip().startswith("for ("):
            raise ValueError(f"This loop cannot be counted: {line.strip()}")
        if closes > opens or line.strip().startswith("}"):
            times.pop()
        if loop is None and not _WHOLE.search(line):
            called = [word for word in re.findall(r"(\w+)\(", line) if word in bodies]
            own = [cost_of([_WHOLE_TERM.sub("", line)]), *(_cost_of_function(counted, word) for word in called)]
            found = [count + times[-1] * sum(each) for count, each in zip(found, zip(*own, strict=True), strict=True)]
        if opens > closes or (opens and line.strip().startswith("}")):
            times.append(times[-1] * _runs(loop, times, given))
    return found


def _runs(loop: re.Match[str] | None, times: list[Fraction], given: int | None) -> Fraction:
    """Return how often a block runs each time that it is met; one up to the counter around it, on the average."""
    if loop is None:
        return Fraction(1)
    if loop[2].isdigit():
        return Fraction(int(loop[2]))
    if len(loop[2]) > 1:  # those up to a counter have one letter
        if given is None:
            raise ValueError(f"A loop runs up to {loop[2]}; say how much that is.")
        return Fraction(given)
    around = times[-1] / times[-2]
    return (around + 1) / 2 if loop[1] == "<=" else (around - 1) / 2
