"""Describe the strain paper's figures 1 to 8 with the results of the study."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.report.data.description import Axis, Band, Curve, Figure, Layer, Look, Role
from becalm.studies.sheets import SheetContents
from becalm.studies.strain.strain import SHOWN, ShownRecord, StrainStudy
from becalm.studies.strain.strain_gauge import Gauge
from becalm.studies.strain.strain_methods import AVERAGE, BECALM, BUTTERWORTH, KALMAN, READINGS

_ZOOM_S = 30.0  # first part of the gauge's record, in figure 8
_TRIALS: dict[str, Role] = {  # filters that are drawn; the curves of the other filters overlap with these
    "becalm, smoothed": "clean",
    "G by likelihood, R at rest": "other",
    "G of the simulation, R at rest": "other",
}
_SIGNAL = "signal"
_STYLES: dict[str, tuple[Role, Look]] = {
    _SIGNAL: ("truth", "dashed"),
    READINGS: ("readings", "line"),
    BECALM: ("clean", "line"),
}
_TIME = Axis("time (s)")


def sheets(study: StrainStudy) -> tuple[SheetContents, ...]:
    """Return the figures of the study; without a gauge, figures 7 and 8 are left out."""
    drawn = [(title, "strain", layers) for title, layers in _simulated(study.shown).items()]
    if study.gauge is not None:
        title = "The bridge's gauge and its filters"
        for caption, until_s in ((f"{title}.", np.inf), (f"{title}, first {_ZOOM_S:g} s.", _ZOOM_S)):
            drawn.append((caption, study.gauge.unit, _real(study.gauge, until_s)))
    return tuple(_sheet(number, *each) for number, each in enumerate(drawn, start=1))


def _sheet(number: int, title: str, unit: str, layers: tuple[Layer, ...]) -> SheetContents:
    name = f"strain-{number}"
    return SheetContents(name, (Figure(name, f"Figure {number}. {title}", _TIME, Axis(unit), layers),))


def _simulated(shown: ShownRecord) -> dict[str, tuple[Layer, ...]]:
    t, truth, outputs = shown
    values = outputs | {_SIGNAL: truth}

    def lines(*names: str) -> tuple[Curve, ...]:
        return tuple(_curve(name, t, values[name]) for name in names)

    def errors(*names: str) -> tuple[Curve, ...]:
        return tuple(_curve(name, t, outputs[name] - truth) for name in names)

    return {
        f"Signal and noisy readings, noise {SHOWN:g}.": lines(READINGS, _SIGNAL),
        "The Kalman filters.": lines(KALMAN, BECALM, _SIGNAL),
        "Noise before and after the filter.": errors(READINGS, KALMAN),
        "The Butterworth filter.": lines(BUTTERWORTH, _SIGNAL),
        "Errors of both.": errors(BUTTERWORTH, KALMAN, BECALM),
        "Software averaging.": lines(AVERAGE, _SIGNAL),
    }


def _curve(name: str, time_s: Floats, values: Floats) -> Curve:
    return Curve(name, time_s, values, *_STYLES.get(name, ("other", "line")))


def _real(gauge: Gauge, until_s: float) -> tuple[Layer, ...]:
    first = gauge.time_s - gauge.time_s[0] < until_s
    time_s, readings = gauge.time_s[first], gauge.readings[first]
    return (
        Band(READINGS, time_s, readings, readings, "readings"),
        *(Curve(name, time_s, gauge.trials[name].output[first], role) for name, role in _TRIALS.items()),
    )
