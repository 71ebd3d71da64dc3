"""Describe the figures of the IMU study."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.identification.several.step_spectrum import Sensor
from becalm.report.data.description import Axis, Band, Curve, DrawnSurface, Figure, Layer, Look, Role
from becalm.studies.imu.imu import SensorStudy, Study
from becalm.studies.imu.imu_records import PRINTED, RATE_HZ
from becalm.studies.imu.imu_responses import FIGURE_STRIDE, STEP, STEP_AT_S, FilterResponse
from becalm.studies.imu.imu_switching import ImmComparison
from becalm.studies.sheets import SheetContents

_BLOCK = 100  # number of readings in a mean
_QUICKEST_MS = 1e3 / RATE_HZ  # least time shown, one row, because a logarithmic axis cannot show 0
_CLOSE_S = (4.5, 6.5)  # part of a response that figure 9 shows
_TIME = Axis("time (s)")
_QUANTITIES: dict[Sensor, str] = {"accelerometer": "acceleration", "gyroscope": "angular rate"}
_LOOKS: tuple[Look, ...] = ("line", "dashed", "dotted")  # line styles of fixed gains of orders 1, 2 and 3


def sheets(study: Study) -> tuple[SheetContents, ...]:
    """Return the figures of the study."""
    results = study.sensors.items()
    return (
        SheetContents("imu-record", tuple(_record(*each) for each in results)),
        SheetContents("imu-spectra", tuple(_spectrum(*each) for each in results), 2),
        *(SheetContents(f"imu-{sensor}", _panels(sensor, one.responses), 2) for sensor, one in results),
        SheetContents("imu-surface", tuple(_surface(*each) for each in results), 2),
        SheetContents("imu-optimum", tuple(_optimum(*each) for each in results), 2),
        SheetContents("imu-contest", (_comparison(study.comparison),)),
    )


def _record(sensor: Sensor, result: SensorStudy) -> Figure:
    """Draw figure 3."""
    z = result.record - result.record.mean()
    times_s = np.arange(len(z)) / RATE_HZ
    means = z.reshape(-1, _BLOCK).mean(axis=1)
    layers = (
        Band("readings", times_s, z, z, "readings"),
        Curve(f"mean of {_BLOCK}", times_s[_BLOCK // 2 :: _BLOCK], means, "truth"),
    )
    return Figure(f"imu-record-{sensor}", sensor, _TIME._replace(low=0.0), Axis("centred reading"), layers)


def _spectrum(sensor: Sensor, result: SensorStudy) -> Figure:
    """Draw figure 4."""
    f, density = result.spectrum
    layers = (Curve("readings", f[1:], np.sqrt(density[1:]), "readings"),)
    x, y = Axis("frequency (Hz)", log=True), Axis("amplitude density (unit/√Hz)", log=True)
    return Figure(f"imu-spectra-{sensor}", sensor, x, y, layers)


def _panels(sensor: Sensor, responses: tuple[FilterResponse, ...]) -> tuple[Figure, ...]:
    """Draw figure 5 or 6."""
    return tuple(_panel(sensor, each) for each in responses)


def _panel(sensor: Sensor, each: FilterResponse) -> Figure:
    name, noise, process, start = each.setting
    title = f"{name}) R = {noise:.4g}, Q = {process:.4g}, P0 = {start:g}"
    layers = (_output("output", each.output, "clean"), _step(each.output))
    return Figure(f"imu-{sensor}-{name}", title, _TIME, Axis(_QUANTITIES[sensor]), layers)


def _output(name: str, output: Floats, role: Role) -> Curve:
    return Curve(name, np.arange(len(output)) * FIGURE_STRIDE / RATE_HZ, output, role)


def _step(output: Floats) -> Curve:
    end_s = (len(output) - 1) * FIGURE_STRIDE / RATE_HZ
    x, y = np.array([0, STEP_AT_S, STEP_AT_S, end_s]), np.array([0, 0, STEP, STEP])
    return Curve("step", x, y, "truth", "dotted")


def _surface(sensor: Sensor, result: SensorStudy) -> Figure:
    """Draw figure 8: the valley, the paper's optimum and the ends of the searches over R and Q."""
    cost, found, printed = result.optimum.surface, result.optimum, PRINTED[sensor]
    ends = np.log10([[end.noise_variance, end.process_variance] for end in found.ends[1:]])
    tuned = np.log10([[printed.tuned_noise, printed.tuned_process]])
    layers: tuple[Layer, ...] = (
        DrawnSurface("log10 J", cost.log_noise, cost.log_process, np.log10(cost.cost)),
        Curve("Q/R found", cost.log_noise, cost.log_noise + np.log10(found.ratio), "clean", "dashed"),
        Curve("simplex ended", ends[:, 0], ends[:, 1], "other", "points"),
        Curve("paper", tuned[:, 0], tuned[:, 1], "other", "points"),
    )
    x, y = _spanned("log10 R", cost.log_noise), _spanned("log10 Q", cost.log_process)
    return Figure(f"imu-surface-{sensor}", sensor, x, y, layers)


def _spanned(label: str, values: Floats) -> Axis:
    return Axis(label, low=float(values[0]), high=float(values[-1]))


def _optimum(sensor: Sensor, result: SensorStudy) -> Figure:
    """Draw figure 9."""
    roles: dict[str, Role] = {"here": "clean"}
    layers = []
    for each in result.tuned:
        name, noise, process, _ = each.setting
        layers.append(_output(f"{name}: Q/R = {process / noise:.4g}", each.output, roles.get(name, "other")))
    x = _TIME._replace(low=_CLOSE_S[0], high=_CLOSE_S[1])
    drawn = (*layers, _step(result.tuned[0].output))
    return Figure(f"imu-optimum-{sensor}", sensor, x, Axis(_QUANTITIES[sensor]), drawn)


def _comparison(result: ImmComparison) -> Figure:
    """Draw noise at rest against the time to nine tenths of a step: fixed gains, the paper's filters, an IMM."""
    times_ms = np.array([max(each.reached_ms, _QUICKEST_MS) for each in result.switched])
    gains = np.array([each.rest_gain for each in result.switched])
    labels = tuple(f"{each.step_std:.2g} std" for each in result.switched)
    layers = (
        *(
            Curve(f"fixed gain, order {one.order}", one.reached_ms, one.rest_gain, "other", look)
            for one, look in zip(result.gain_curves, _LOOKS, strict=True)
        ),
        *(
            Curve(f"paper's optimum, {one.sensor}", *_place(one.reached_ms, one.rest_gain), "other", "points")
            for one in result.fixed
        ),
        Curve("switching", times_ms, gains, "clean", "points", labels),
    )
    x = Axis("time to nine tenths of a step (ms)", log=True, low=5e-2, high=3e3)
    y = Axis("noise at rest / noise read", log=True)
    return Figure("imu-contest", "Noise at rest against the time to follow a step", x, y, layers)


def _place(x: float, y: float) -> tuple[Floats, Floats]:
    return np.array([x]), np.array([y])
