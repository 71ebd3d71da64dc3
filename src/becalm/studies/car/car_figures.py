"""Describe the figures of the car study: the paper's Figures 6 to 10, spectrograms and the real car."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.metrics.spectrum import spectrogram
from becalm.report.data.description import Axis, Curve, DrawnSurface, Figure, Role
from becalm.studies.car.car import MEASURED, OWN, PRINTED, TRUTH, CarStudy
from becalm.studies.sheets import SheetContents

_CLOSE_S = (20.0, 25.0)  # part of the vertical acceleration that is shown; a whole minute would be unreadable
_SEGMENT = 512  # samples in a segment of a spectrogram
_HIGHEST_HZ, _FAINTEST = 30.0, 1e-5  # highest frequency and lowest density, in (m/s²)²/Hz, of a spectrogram
_TIME, _SPEED = Axis("time (s)"), Axis("speed (km/h)")
_ALONG, _UP = Axis("longitudinal acceleration (m/s²)"), Axis("vertical acceleration (m/s²)")


def sheets(result: CarStudy) -> tuple[SheetContents, ...]:
    """Return the figures of the study; the figure of the real car is left out if its recordings are missing."""
    times, drawn = result.drive.truth.times_s, result.estimates
    roles: dict[str, Role] = {MEASURED: "readings", PRINTED: "other", OWN: "clean", TRUTH: "truth"}
    whole, close = slice(None), slice(*np.searchsorted(times, _CLOSE_S))

    def curves(column: int, *names: str, shown: slice = whole) -> tuple[Curve, ...]:
        return tuple(_curve(name, times[shown], drawn[name][shown, column], roles[name]) for name in names)

    estimated = (PRINTED, OWN, TRUTH)
    speed = (_curve(MEASURED, times, result.drive.speed_kmh, "readings"),)
    near = curves(2, *estimated, shown=close)
    figures = [
        Figure("car-6-speed", "Figure 6: speed", _TIME, _SPEED, speed),
        Figure("car-7-longitudinal", "Figure 7: longitudinal acceleration", _TIME, _ALONG, curves(1, MEASURED)),
        Figure("car-8-vertical", "Figure 8: vertical acceleration", _TIME, _UP, curves(2, MEASURED)),
        Figure("car-9-longitudinal", "Figure 9: longitudinal, estimated", _TIME, _ALONG, curves(1, *estimated)),
        Figure("car-10-vertical", "Figure 10: vertical, estimated, a few seconds of it", _TIME, _UP, near),
    ]
    if result.real is not None:
        figures.append(_real(result))
    shown = tuple(
        _spectrogram(f"car-spectrogram-{number}", name, times, drawn[name][:, 2])
        for number, name in enumerate((MEASURED, OWN), start=1)
    )
    return *(SheetContents(figure.name, (figure,)) for figure in figures), SheetContents("car-spectrogram", shown)


def _spectrogram(name: str, shown: str, times_s: Floats, values: Floats) -> Figure:
    """Draw a signal's power over time and frequency."""
    power = spectrogram(values, 1 / float(np.diff(times_s).mean()), _SEGMENT)
    low = power.frequency_hz <= _HIGHEST_HZ
    decibels = 10 * np.log10(np.maximum(power.density[low].T, _FAINTEST))
    layer = DrawnSurface("density (dB of (m/s²)²/Hz)", power.times_s, power.frequency_hz[low], decibels, by_point=True)
    return Figure(name, f"Vertical acceleration, {shown}", _TIME, Axis("frequency (Hz)"), (layer,))


def _real(result: CarStudy) -> Figure:
    assert result.real is not None
    real, times = result.real, result.real.record.times_s
    curves = (
        _curve("read", times, real.record.readings[:, 1], "readings"),
        _curve("three sensors", times, real.estimate[:, 1], "clean"),
        _curve("derivative of the speed", times, real.slope, "truth"),
    )
    return Figure("car-real", "A real car", _TIME, _ALONG, curves)


def _curve(name: str, times_s: Floats, values: Floats, role: Role) -> Curve:
    """Return a curve through the finite values; the sensors of the real car are not sampled at the same times."""
    finite = np.isfinite(values)
    return Curve(name, times_s[finite], values[finite], role, "dashed" if role == "truth" else "line")
