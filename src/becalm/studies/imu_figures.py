"""The figures of the IMU study, drawn with matplotlib from what the study holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.studies.imu_records import PRINTED, RATE_HZ, SENSORS
from becalm.studies.imu_responses import EVERY, STEP, STEP_AT_S, Answer

if TYPE_CHECKING:
    from becalm.studies.imu import Study

_BLOCK = 100  # readings that an envelope joins
_QUICKEST_MS = 1e3 / RATE_HZ


def figures(study: Study, folder: Path) -> dict[str, str]:
    """Draw all figures as SVG into a folder; return the name of each file.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    drawers = {
        "record": _record,
        "spectra": _spectra,
        "accelerometer": lambda figure, held: _panels(figure, held.sensors["accelerometer"].answers, "acceleration"),
        "gyroscope": lambda figure, held: _panels(figure, held.sensors["gyroscope"].answers, "angular rate"),
        "surface": _surface,
        "optimum": _optimum,
        "contest": _contest,
    }
    names: dict[str, str] = {}
    with mpl.rc_context({"svg.hashsalt": "becalm", "font.size": 9, "lines.linewidth": 1}):
        for name, draw in drawers.items():
            figure = Figure(figsize=(8, 6 if name == "accelerometer" else 4), layout="constrained")
            draw(figure, study)
            names[name] = f"imu-{name}.svg"
            figure.savefig(folder / names[name], metadata={"Date": None})
    return names


def _record(figure: Any, study: Study) -> None:
    """Draw figure 3: between the least and the most of every hundred readings."""
    for axes, sensor in zip(figure.subplots(2, 1, sharex=True), SENSORS, strict=True):
        z = study.sensors[sensor].record
        blocks = (z - z.mean()).reshape(-1, _BLOCK)
        times_s = np.arange(len(blocks)) * _BLOCK / RATE_HZ
        axes.fill_between(times_s, blocks.min(axis=1), blocks.max(axis=1), linewidth=0)
        axes.plot(times_s, blocks.mean(axis=1), color="black", label=f"mean of {_BLOCK}")
        axes.set(title=sensor, ylabel="centred reading")
        axes.legend(loc="upper right")
    axes.set_xlabel("time, s")


def _spectra(figure: Any, study: Study) -> None:
    """Draw figure 4."""
    for axes, sensor in zip(figure.subplots(1, 2), SENSORS, strict=True):
        shown = study.sensors[sensor].spectrum
        axes.loglog(shown.frequency_hz[1:], np.sqrt(shown.density[1:]))
        axes.set(title=sensor, xlabel="frequency, Hz", ylabel="amplitude density, unit / sqrt(Hz)")


def _panels(figure: Any, answers: tuple[Answer, ...], quantity: str) -> None:
    """Draw figure 5 or 6."""
    for axes, each in zip(figure.subplots(len(answers) // 2, 2, sharex=True).flat, answers, strict=True):
        _step(axes, each.output, "output")
        noise, process = each.setting.noise_variance, each.setting.process_variance
        axes.set_title(f"{each.setting.name}) R = {noise:.4g}, Q = {process:.4g}, P0 = {each.setting.start:g}")
    figure.supxlabel("time, s")
    figure.supylabel(quantity)


def _step(axes: Any, output: Floats, label: str) -> None:
    times_s = np.arange(len(output)) * EVERY / RATE_HZ
    axes.plot(times_s, output, label=label)
    axes.plot([0, STEP_AT_S, STEP_AT_S, times_s[-1]], [0, 0, STEP, STEP], ":", color="black")


def _surface(figure: Any, study: Study) -> None:
    """Draw figure 8: the valley, the paper's optimum and where searches over R and Q ended."""
    for axes, sensor in zip(figure.subplots(1, 2), SENSORS, strict=True):
        found = study.sensors[sensor].optimum
        held, printed = found.surface, PRINTED[sensor]
        levels = np.linspace(np.log10(held.cost.min()), np.log10(held.cost.max()), 16)
        filled = axes.contourf(held.log_noise, held.log_process, np.log10(held.cost).T, levels)
        figure.colorbar(filled, ax=axes, label="log10 J", format="%.1f")
        axes.plot(held.log_noise, held.log_noise + np.log10(found.ratio), "w--", label="Q/R found")
        ends = np.log10([[end.noise_variance, end.process_variance] for end in found.ends[1:]])
        axes.plot(*ends.T, "wo", mec="black", label="simplex ended")
        axes.plot(np.log10(printed.tuned_noise), np.log10(printed.tuned_process), "r*", ms=10, label="paper")
        axes.set(title=sensor, xlabel="log10 R", ylabel="log10 Q")
        axes.set(xlim=held.log_noise[[0, -1]], ylim=held.log_process[[0, -1]])
        axes.legend(fontsize=7, loc="lower right", facecolor="0.6")


def _optimum(figure: Any, study: Study) -> None:
    """Draw figure 9."""
    for axes, sensor in zip(figure.subplots(1, 2), SENSORS, strict=True):
        for each in study.sensors[sensor].tuned:
            ratio = each.setting.process_variance / each.setting.noise_variance
            _step(axes, each.output, f"{each.setting.name}: Q/R = {ratio:.4g}")
        axes.set(title=sensor, xlabel="time, s", xlim=(4.5, 6.5))
        axes.legend()


def _contest(figure: Any, study: Study) -> None:
    """Draw noise at rest against the time to nine tenths: fixed gains, the paper's, and the filter that switches."""
    axes, held = figure.subplots(), study.contest
    for curve, style in zip(held.fronts, ("-", "--", ":"), strict=True):
        axes.plot(curve.reached_ms, curve.rest_gain, style, color="0.35", label=f"fixed gain, order {curve.order}")
    for one, marker in zip(held.fixed, "os", strict=True):
        axes.plot(one.reached_ms, one.rest_gain, marker, mfc="none", label=f"paper's optimum, {one.sensor}")
    times_ms = [max(each.reached_ms, _QUICKEST_MS) for each in held.switched]
    axes.plot(times_ms, [each.rest_gain for each in held.switched], "D", color="C3", label="switching")
    for time_ms, each in zip(times_ms, held.switched, strict=True):
        axes.annotate(f"{each.step_std:.2g} std", (time_ms, each.rest_gain), xytext=(5, 5), textcoords="offset points")
    axes.set(xscale="log", yscale="log", xlim=(5e-2, 3e3))
    axes.set(xlabel="time to nine tenths of a step, ms", ylabel="noise at rest / noise read")
    axes.legend(fontsize=8)
