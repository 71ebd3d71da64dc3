"""Convert the coefficients of an Allan deviation into the unit of the readings and into units of data sheets."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from becalm.errors import UsageError
from becalm.identification.at_rest.allan_terms import NoiseTerm, NoiseTerms
from becalm.identification.at_rest.datasheet import convert, random_walk_in, white_noise_in


class _SheetUnits(NamedTuple):
    """The units in which the data sheets of one kind of sensor give its noise."""

    bias: str  # of the bias instability
    white: tuple[str, ...]  # of the white noise
    walk: str  # of the random walk


_SHEETS = (
    _SheetUnits("ug", ("ug/sqrt(Hz)", "m/s/sqrt(h)"), "ug/sqrt(h)"),
    _SheetUnits("deg/h", ("deg/s/sqrt(Hz)", "deg/sqrt(h)"), "deg/h/sqrt(h)"),
    _SheetUnits("um/m", ("um/m/sqrt(Hz)",), "um/m/sqrt(h)"),
)


@dataclass(frozen=True)
class QuotedCoefficient:
    """A coefficient of an Allan deviation, in a unit of data sheets.

    Attributes
    ----------
    unit : str
        Unit of the figures. A density per sqrt(Hz) is one-sided; a density per sqrt(h) is two-sided.
    value, standard_error, limit : float or None
        As in `Coefficient`, in this unit.
    """

    unit: str
    value: float | None
    standard_error: float | None
    limit: float | None


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of an Allan deviation.

    Attributes
    ----------
    unit : str
        Unit of the figures.
    value, standard_error : float or None
        The coefficient and its standard error; None if the readings at rest do not determine it.
    limit : float or None
        One-sided upper limit at 95 % confidence, with or without a value; None if unknown.
    reason : str
        A sentence on why `value` is None; "" otherwise.
    quoted : tuple of QuotedCoefficient
        The same coefficient in units of data sheets other than `unit`.
    """

    unit: str
    value: float | None
    standard_error: float | None
    limit: float | None
    reason: str
    quoted: tuple[QuotedCoefficient, ...]


@dataclass(frozen=True)
class AllanNoise:
    """The figures of the Allan deviation over one stretch at rest. Densities in the unit of the readings are two-sided.

    Attributes
    ----------
    stretch_s : (float, float)
        Start and end of the stretch, in seconds after the first sample.
    white_noise : Coefficient
        N, in unit s^(1/2).
    bias_instability : Coefficient
        B, in unit.
    random_walk : Coefficient
        K, in unit / s^(1/2).
    misfit : float
        Misfit of the three terms to the Allan deviation; about 1 if they describe the sensor.
    noise_variance : float or None
        R = N^2 rate, in unit^2.
    random_walk_density : float or None
        q = K^2, in unit^2/s; a *small* value trusts the bias to stay constant.
    """

    stretch_s: tuple[float, float]
    white_noise: Coefficient
    bias_instability: Coefficient
    random_walk: Coefficient
    misfit: float
    noise_variance: float | None
    random_walk_density: float | None


def allan_noise(terms: NoiseTerms, unit: str, stretch_s: tuple[float, float], rate_hz: float) -> AllanNoise:
    """Convert the coefficients of an Allan deviation into the unit of the readings and units of data sheets.

    Parameters
    ----------
    terms : NoiseTerms
        From `becalm.identification.at_rest.allan_terms.noise_terms`.
    unit : str
        Unit of the readings, "" if unknown.
    stretch_s : (float, float)
        Start and end of the stretch at rest, in seconds after the first sample.
    rate_hz : float
        Rate of the readings, in Hz.

    Returns
    -------
    AllanNoise
        The figures. If no data sheet uses `unit`, only the white noise is quoted in a second unit, `unit` / sqrt(Hz).
    """
    white, bias, walk = _sheet_factors(unit)
    return AllanNoise(
        stretch_s,
        _coefficient(terms.white, f"{unit} s^(1/2)".strip(), white),
        _coefficient(terms.bias_instability, unit, bias),
        _coefficient(terms.random_walk, f"{unit or 1}/s^(1/2)", walk),
        terms.misfit,
        terms.to_noise_variance(rate_hz) if np.isfinite(terms.white.value) else None,
        terms.to_random_walk_density() if np.isfinite(terms.random_walk.value) else None,
    )


def _sheet_factors(unit: str) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Return three dictionaries, for N, B and K: the factor from the coefficient's unit to each data sheet unit."""
    sheet = _sheet_of(unit)
    if sheet is None:
        return {f"{unit or 1}/sqrt(Hz)": float(np.sqrt(2))}, {}, {}
    return (
        {quoted: white_noise_in(quoted, 1.0, unit) for quoted in sheet.white},
        {sheet.bias: convert(1.0, unit, sheet.bias)},
        {sheet.walk: random_walk_in(sheet.walk, 1.0, unit)},
    )


def _sheet_of(unit: str) -> _SheetUnits | None:
    """Return the data sheet units that `unit` can be converted to; None if there are none."""
    for sheet in _SHEETS:
        with suppress(UsageError):
            convert(1.0, unit, sheet.bias)
            return sheet
    return None


def _coefficient(term: NoiseTerm, unit: str, factors: dict[str, float]) -> Coefficient:
    """Return a coefficient in `unit`, and times each factor in the data sheet unit of that factor."""
    quoted = tuple(QuotedCoefficient(name, *_scaled(term, factor)) for name, factor in factors.items() if name != unit)
    return Coefficient(unit, *_scaled(term, 1.0), term.reason, quoted)


def _scaled(term: NoiseTerm, factor: float) -> tuple[float | None, float | None, float | None]:
    """Return the value, standard error and limit of a coefficient, times a factor; None where unknown."""
    figures = (term.value, term.standard_error, term.limit)
    value, error, limit = (float(factor * figure) if np.isfinite(figure) else None for figure in figures)
    return value, error, limit
