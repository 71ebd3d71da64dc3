"""Convert one unit to another with pint, which is imported at the first conversion."""

from __future__ import annotations

import re
from fractions import Fraction
from functools import cache
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

from becalm.errors import UsageError
from becalm.files.units.unit_spelling import DEFINITIONS, QUANTITIES, tidy_unit

if TYPE_CHECKING:
    from pint import Unit, UnitRegistry

KNOWN = "V, mV/V, g, m/s^2, deg/s, rad/s, um/m, MPa, kN, kgf, degC, uT, counts or ug/sqrt(Hz)"
_MOST_LETTERS = 60  # characters of the longest unit that is parsed

_SPELLINGS = (
    (r"\bsqrt\(([^()]+)\)", r"(\1)^0.5"),
    (r"%", "percent"),
    (r"\bdeg ?(C|F)\b", r"deg\1"),
    (r"\b([munk]?)(N)m\b", r"\1N*m"),
    (r"(?<=[A-Za-z])\.(?=[A-Za-z])", "*"),  # UCUM's product
    (r"(?<=[A-Za-z])(-?\d)(?!\d)", r"^\1"),  # m/s2
)
# The only number is 1, and exponents are below 10: a "unit" in a file must not make pint compute large powers.
_WRITTEN = re.compile(r"(?:[A-Za-z_]+|\^-?\d(?:\.\d)?(?![\d.^])|(?<![\d.^])1(?![\d.])|[*/ ()])+")
_AS_ON_SENSORS = ((r"\b([mun]?)g\b", r"\1g_n"), (r"^(C|F)$", r"deg\1"))  # g is an acceleration, C a temperature
_SENSORS_FIRST = (_AS_ON_SENSORS, ())  # the meanings of g, C and F, in the order in which they are tried
_SCALES = {"degree_Celsius", "degree_Fahrenheit"}  # units with a zero of their own


class Conversion(NamedTuple):
    """A conversion from one unit to another: factor * value + offset.

    Attributes
    ----------
    factor : float
        How many of the second unit make one of the first.
    offset : float
        Offset in the second unit; 0 except between temperature scales.
    """

    factor: float = 1.0
    offset: float = 0.0


def conversion(unit_from: str, unit_to: str) -> Conversion:
    """Return the conversion from one unit to another.

    Parameters
    ----------
    unit_from, unit_to : str
        Units as in headers: "V", "mV/V", "g", "m/s2", "m.s-2", "deg/s", "um/m", "degC", "ug/sqrt(Hz)". A g alone, or
        in mg and ug, is standard gravity, 9.80665 m/s^2, and a gram only if the other unit is a mass; kg is a mass.
        C and F alone are Celsius and Fahrenheit if the other unit is a temperature.

    Raises
    ------
    UsageError
        If a unit is unknown, or the units measure different quantities, ratios of two kinds, or noise densities of
        two conventions.
    """
    one, other = tidy_unit(unit_from), tidy_unit(unit_to)
    if one == other:
        return Conversion()
    tried = [(_unit(one, reading), _unit(other, reading)) for reading in _SENSORS_FIRST]
    fitting = [pair for pair in tried if pair[0].dimensionality == pair[1].dimensionality]
    if not fitting:
        raise UsageError(_incompatible((one, other), *tried[0]))
    _refuse_unlike((one, other), *fitting[0])
    return _conversion_between(*fitting[0])


def _conversion_between(one: Unit, other: Unit) -> Conversion:
    registry, steps = _registry(), (_step_of(one), _step_of(other))
    offset = 0 if steps == (one, other) else registry.convert(0, one, other)
    return Conversion(float(registry.convert(1, *steps)), float(offset))


def _step_of(unit: Unit) -> Unit:
    """Return the unit of a difference of two values: for a temperature scale, a degree without the offset."""
    ((name, _), *more) = _registry().Quantity(1, unit).unit_items() or [("", 0)]
    return _registry().Unit(f"delta_{name}") if name in _SCALES and not more else unit


@cache
def _registry() -> UnitRegistry[Any]:
    from pint import UnitRegistry

    return UnitRegistry(DEFINITIONS, non_int_type=Fraction)  # exact: a factor is rounded once, at the end


def _unit(text: str, reading: tuple[tuple[str, str], ...]) -> Unit:
    """Parse a unit; the substitutions `reading` decide what g, C and F mean: on sensors, or in physics."""
    plain = text
    for pattern, better in (*_SPELLINGS, *reading):
        plain = re.sub(pattern, better, plain)
    unknown = UsageError(f"{text!r} is not a unit that becalm can convert; write one as {KNOWN}.")
    if len(plain) > _MOST_LETTERS or not _WRITTEN.fullmatch(plain):
        raise unknown
    try:
        return _registry().parse_units(plain)
    except Exception as cause:  # pint has no common base class for parsing errors
        raise unknown from cause


def _refuse_unlike(written: tuple[str, str], one: Unit, other: Unit) -> None:
    """Refuse units of equal dimension but different meaning: densities of two conventions, ratios of two kinds."""
    (root, ratio), (other_root, other_ratio) = _quantities(one), _quantities(other)
    if root != other_root:
        raise UsageError(
            f"{written[0]!r} and {written[1]!r} are densities of two conventions, one-sided per root of hertz and"
            " two-sided per root of time; becalm.identification.at_rest.datasheet converts between them."
        )
    if ratio and other_ratio and ratio != other_ratio:
        raise UsageError(
            f"{written[0]!r} is a ratio of {' and '.join(sorted(ratio))}, {written[1]!r} of"
            f" {' and '.join(sorted(other_ratio))}; to convert them, the sensitivity of the sensor is needed, such as a"
            " gauge factor. Give two units of one kind."
        )


def _quantities(unit: Unit) -> tuple[frozenset[str], frozenset[str]]:
    """Return the quantities under roots and, if the other factors are a dimensionless ratio, the quantities in it."""
    registry = _registry()
    items: Any = registry.Quantity(1, unit).unit_items()
    parts = [(registry.Unit(name), power) for name, power in items]
    roots = frozenset(_quantity_name(part) for part, power in parts if power % 1)
    rest = [(part, power) for part, power in parts if not power % 1]
    whole = prod((part**power for part, power in rest), start=registry.Unit(""))
    kinds = frozenset(_quantity_name(part) for part, _ in rest if not part.dimensionless)
    return roots, kinds if whole.dimensionless else frozenset()


def _quantity_name(unit: Unit) -> str:
    """Return the name of the quantity that a unit measures."""
    for name, example in QUANTITIES.items():
        if _registry().Unit(example).dimensionality == unit.dimensionality:
            return name
    items: Any = unit.dimensionality.items()
    powers = [(name.strip("[]"), float(power)) for name, power in items]
    return " ".join(name if power == 1 else f"{name}^{power:g}" for name, power in powers)


def _incompatible(written: tuple[str, str], one: Unit, other: Unit) -> str:
    kinds = _quantity_name(one), _quantity_name(other)
    example = f", as {QUANTITIES[kinds[0]].replace('g_n', 'g')!r}" if kinds[0] in QUANTITIES else ""
    hint = ""
    if "mass" in kinds and "force" in kinds:
        hint = " Kilograms of force are written kgf."
    elif any(re.search(r"\b[mun]?g\b", unit) for unit in written):
        hint = " A g is standard gravity; it is a gram only if the other unit is a mass."
    return (
        f"{written[0]!r} is a unit of {kinds[0]}, {written[1]!r} of {kinds[1]}; they cannot be converted."
        f" Give another unit of {kinds[0]}{example}.{hint}"
    )
