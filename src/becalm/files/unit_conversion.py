"""From one unit to another, by pint, which is loaded when the first of them is asked for."""

from __future__ import annotations

import re
from fractions import Fraction
from functools import cache
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

from becalm.errors import UsageError
from becalm.files.unit_definitions import DEFINITIONS, QUANTITIES
from becalm.files.unit_spelling import tidy_unit

if TYPE_CHECKING:
    from pint import Unit, UnitRegistry

KNOWN = "V, mV/V, g, m/s^2, deg/s, rad/s, um/m, MPa, kN, kgf, degC, uT, counts or ug/sqrt(Hz)"
_MOST_LETTERS = 60

_SPELLINGS = (
    (r"\bsqrt\(([^()]+)\)", r"(\1)^0.5"),
    (r"%", "percent"),
    (r"\bdeg ?(C|F)\b", r"deg\1"),
    (r"\b([munk]?)(N)m\b", r"\1N*m"),
    (r"(?<=[A-Za-z])\.(?=[A-Za-z])", "*"),  # UCUM's product
    (r"(?<=[A-Za-z])(-?\d)(?!\d)", r"^\1"),  # m/s2
)
# No number but 1, and exponents of one digit: what a file calls a unit is not worked out as a sum of powers.
_WRITTEN = re.compile(r"(?:[A-Za-z_]+|\^-?\d(?:\.\d)?(?![\d.^])|(?<![\d.^])1(?![\d.])|[*/ ()])+")
_AS_ON_SENSORS = ((r"\b([mun]?)g\b", r"\1g_n"), (r"^(C|F)$", r"deg\1"))
_SENSORS_FIRST = (_AS_ON_SENSORS, ())
_SCALES = {"degree_Celsius", "degree_Fahrenheit"}


class Conversion(NamedTuple):
    """How values in one unit are values in another: factor * value + offset.

    Attributes
    ----------
    factor : float
        Units of the second kind in one of the first.
    offset : float
        In the second unit; other than 0 between scales of temperature only.
    """

    factor: float = 1.0
    offset: float = 0.0


def conversion(unit_from: str, unit_to: str) -> Conversion:
    """Return how values are carried from one unit to another.

    Parameters
    ----------
    unit_from, unit_to : str
        As in headers: "V", "mV/V", "g", "m/s2", "m.s-2", "deg/s", "um/m", "degC", "ug/sqrt(Hz)". A g alone, or in
        mg and ug, is standard gravity, 9.80665 m/s^2, but a gram where only that fits the other unit; kg is a mass.
        C and F are Celsius and Fahrenheit where only these fit.

    Raises
    ------
    UsageError
        If a unit is not known, or the two measure different things.
    """
    one, other = tidy_unit(unit_from), tidy_unit(unit_to)
    if one == other:
        return Conversion()
    tried = [(_unit(one, reading), _unit(other, reading)) for reading in _SENSORS_FIRST]
    fitting = [pair for pair in tried if pair[0].dimensionality == pair[1].dimensionality]
    if not fitting:
        raise UsageError(_incompatible((one, other), *tried[0]))
    _refuse_unlike((one, other), *fitting[0])
    return _between(*fitting[0])


def _between(one: Unit, other: Unit) -> Conversion:
    registry, steps = _registry(), (_step_of(one), _step_of(other))
    offset = 0 if steps == (one, other) else registry.convert(0, one, other)
    return Conversion(float(registry.convert(1, *steps)), float(offset))


def _step_of(unit: Unit) -> Unit:
    """Return the unit of differences: a degree between temperatures, for one on a scale."""
    ((name, _), *more) = _registry().Quantity(1, unit).unit_items() or [("", 0)]
    return _registry().Unit(f"delta_{name}") if name in _SCALES and not more else unit


@cache
def _registry() -> UnitRegistry[Any]:
    from pint import UnitRegistry

    return UnitRegistry(DEFINITIONS, non_int_type=Fraction)  # exact: a factor is rounded once, at the end


def _unit(text: str, reading: tuple[tuple[str, str], ...]) -> Unit:
    """Return a unit whose g and C are read as on sensors, or as in physics."""
    plain = text
    for pattern, better in (*_SPELLINGS, *reading):
        plain = re.sub(pattern, better, plain)
    unknown = UsageError(f"{text!r} is not a unit that becalm can convert; write one as {KNOWN}.")
    if len(plain) > _MOST_LETTERS or not _WRITTEN.fullmatch(plain):
        raise unknown
    try:
        return _registry().parse_units(plain)
    except Exception as cause:  # pint has no one family of errors for what it cannot parse
        raise unknown from cause


def _refuse_unlike(written: tuple[str, str], one: Unit, other: Unit) -> None:
    """Refuse what has equal dimensions and is not the same: densities of two conventions, ratios of unlike things."""
    (root, ratio), (other_root, other_ratio) = _inside(one), _inside(other)
    if root != other_root:
        raise UsageError(
            f"{written[0]!r} and {written[1]!r} are densities of two conventions, one-sided per root of hertz and"
            " two-sided per root of time; becalm.identification.rest.datasheet tells one from the other."
        )
    if ratio and other_ratio and ratio != other_ratio:
        raise UsageError(
            f"{written[0]!r} is a ratio of {' and '.join(sorted(ratio))}, {written[1]!r} of"
            f" {' and '.join(sorted(other_ratio))}; between them stands the sensitivity of a sensor, as a gauge"
            " factor. Give two units of one kind."
        )


def _inside(unit: Unit) -> tuple[frozenset[str], frozenset[str]]:
    """Return what stands within roots, and what the rest is a ratio of, if it is one."""
    registry = _registry()
    items: Any = registry.Quantity(1, unit).unit_items()
    parts = [(registry.Unit(name), power) for name, power in items]
    roots = frozenset(_named(part) for part, power in parts if power % 1)
    rest = [(part, power) for part, power in parts if not power % 1]
    whole = prod((part**power for part, power in rest), start=registry.Unit(""))
    kinds = frozenset(_named(part) for part, _ in rest if not part.dimensionless)
    return roots, kinds if whole.dimensionless else frozenset()


def _named(unit: Unit) -> str:
    """Say in words what a unit measures."""
    for name, known in QUANTITIES.items():
        if _registry().Unit(known).dimensionality == unit.dimensionality:
            return name
    items: Any = unit.dimensionality.items()
    powers = [(name.strip("[]"), float(power)) for name, power in items]
    return " ".join(name if power == 1 else f"{name}^{power:g}" for name, power in powers)


def _incompatible(written: tuple[str, str], one: Unit, other: Unit) -> str:
    kinds = _named(one), _named(other)
    example = f", as {QUANTITIES[kinds[0]].replace('g_n', 'g')!r}" if kinds[0] in QUANTITIES else ""
    hint = ""
    if "mass" in kinds and "force" in kinds:
        hint = " Kilograms of force are written kgf."
    elif any(re.search(r"\b[mun]?g\b", unit) for unit in written):
        hint = " A g is standard gravity, and a gram only beside a mass."
    return (
        f"{written[0]!r} is a unit of {kinds[0]}, {written[1]!r} of {kinds[1]}; they cannot be converted."
        f" Give another unit of {kinds[0]}{example}.{hint}"
    )
