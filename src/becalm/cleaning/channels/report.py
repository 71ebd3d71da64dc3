"""The report of one channel: its filter, the faults of its sensor, and whether its result can be trusted."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from becalm.cleaning.channels.faults import Fault
from becalm.cleaning.channels.judging import Judgement


@dataclass(frozen=True)
class ModeReport:
    """The figures of one mode of a filter with several modes.

    Attributes
    ----------
    share : float
        Mean probability of the mode over the rows.
    bandwidth_hz, lag_s : float or None
        Bandwidth and lag of a filter that has only this mode, in steady state.
    noise_left : float or None
        Standard deviation of the noise that passes this filter, in unit.
    """

    share: float
    bandwidth_hz: float | None = None
    lag_s: float | None = None
    noise_left: float | None = None


@dataclass(frozen=True)
class ChannelReport(Judgement):
    """The filter, the faults and the judgement of one channel.

    Attributes
    ----------
    name, unit : str
        Name and unit of the channel, as in the recording.
    model : str
        "motion", "constant" or "untold".
    order : int or None
        Order of the motion model.
    tones_hz, removed_hz : tuple of float
        Frequencies of the tones that are part of the signal, and of those that were removed as disturbances.
    noise_std, coloured_std : float or None
        Standard deviations of one reading's white noise and coloured noise, in unit. With several modes, `noise_std` is
        that of the first mode.
    q_over_r : float or None
        Process noise density divided by the noise variance of a reading, with time in steps.
    bandwidth_hz, lag_s : float or None
        -3 dB bandwidth and lag, as in `becalm.core.steady.response.Response`.
    delay_s : float or None
        Lag of a filter that waits for later readings; such a filter has no bandwidth_hz and no lag_s.
    independence_s : float or None
        Time between two samples from which on their errors count as independent: the mean over T seconds has the random
        uncertainty sigma sqrt(independence_s / T), at most sigma.
    tuning_spread : float or None
        Relative increase of sigma because the tuning is uncertain.
    calibration_std : float or None
        Standard uncertainty (k = 1) of the calibration, at the mean magnitude of the signal, in unit. Averaging does
        not reduce it. None if the recipe has no calibration.
    timing_share : float or None
        Largest relative increase of sigma because the times of readings are uncertain; None if the recipe has no
        timing.
    modes : dict of str to ModeReport
        Figures of each mode, by its name; a filter with several modes has no bandwidth_hz and no lag_s of its own.
    log_likelihood : float or None
        Log-likelihood of the readings, given the recipe.
    settled_row : int or None
        First row in which the filter has its steady-state gain, counted from 0.
    verdicts : dict
        How often each verdict was given, by its name: "used", "missing" and so on.
    advice : tuple of str
        What to do about the verdicts and the faults.
    faults : tuple of Fault
        Faults of the sensor, and of the times of its rows.
    """

    name: str = ""
    unit: str = ""
    model: str = ""
    order: int | None = None
    tones_hz: tuple[float, ...] = ()
    removed_hz: tuple[float, ...] = ()
    noise_std: float | None = None
    coloured_std: float | None = None
    q_over_r: float | None = None
    bandwidth_hz: float | None = None
    lag_s: float | None = None
    delay_s: float | None = None
    independence_s: float | None = None
    tuning_spread: float | None = None
    calibration_std: float | None = None
    timing_share: float | None = None
    modes: dict[str, ModeReport] = field(default_factory=dict)
    log_likelihood: float | None = None
    settled_row: int | None = None
    verdicts: dict[str, int] = field(default_factory=dict)
    advice: tuple[str, ...] = ()
    faults: tuple[Fault, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Return the report for JSON; unknown figures are None."""
        values = {key: _finite(value) for key, value in asdict(self).items() if key != "lagged"}
        return values | {"describes": self.describes}


def _finite(value: object) -> object:
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value


# Write the report of a channel as cells of a table.

_MOST_PLAIN = 1e6  # numbers from here on are printed with powers of ten
_SELDOM = 0.01  # least mean probability of a mode whose bandwidth is shown


def cells(report: ChannelReport, causal: bool) -> tuple[str, ...]:
    """Return the cells of a channel: model, noise, bandwidth, lag, and whether the model describes the signal."""
    return (
        _model(report),
        amount(report.noise_std, report.unit),
        _bandwidth(report),
        _lag(report, causal),
        _trust(report),
    )


def _bandwidth(report: ChannelReport) -> str:
    """Return the bandwidth, or the range of bandwidths of the modes."""
    if report.modes:
        return _range_text([mode.bandwidth_hz for mode in report.modes.values() if mode.share >= _SELDOM], "Hz")
    return amount(report.bandwidth_hz, "Hz")


def _lag(report: ChannelReport, causal: bool) -> str:
    """Return the lag of a causal filter, the delay of a filter with a lag, or "none" for a smoother."""
    if report.delay_s is not None:
        return f"delayed {amount(report.delay_s, 's')}"
    if report.modes and causal:  # the lag of the mode "still" does not matter: on motion the filter leaves this mode
        moving = {name: mode for name, mode in report.modes.items() if name != "still"}
        name = max(moving, key=lambda name: moving[name].share)
        return f"{amount(moving[name].lag_s, 's')} while {name}"
    return amount(report.lag_s, "s") if causal else "none"


def _trust(report: ChannelReport) -> str:
    """Return whether the model describes the signal, in words."""
    if report.verdict == "fits except":
        return f"except near {amount(report.loudest_hz, 'Hz')}"
    return {"fits": "yes", "does not fit": "no"}.get(report.verdict, "see below")


def _model(report: ChannelReport) -> str:
    """Return the model of the signal in words."""
    if report.order is None:
        return report.model
    if report.modes:
        return "switching: " + ", ".join(f"{name} {mode.share:.0%}" for name, mode in report.modes.items())
    parts = [f"{report.model} of order {report.order}"]
    for what, frequencies in (("tones at", report.tones_hz), ("without", report.removed_hz)):
        if frequencies:
            parts.append(f"{what} {', '.join(f'{frequency:.4g}' for frequency in frequencies)} Hz")
    if report.coloured_std is not None:
        parts.append(f"without coloured noise of {amount(report.coloured_std, report.unit)}")
    return ", ".join(parts)


def _range_text(values: list[float | None], unit: str) -> str:
    known = sorted(value for value in values if value is not None)
    single = not known or known[0] == known[-1]
    return amount(known[0] if known else None, unit) if single else f"{known[0]:.3g} to {amount(known[-1], unit)}"


def amount(value: float | None, unit: str) -> str:
    """Return a value with its unit as text; a dash for None."""
    if value is None:
        return "-"
    rounded = unit in ("s", "Hz") and abs(value) < 1e-12
    text = f"{0.0 if rounded else value:.3g}"
    plain = f"{float(text):.0f}" if "e+0" in text and abs(value) < _MOST_PLAIN else text
    return f"{plain} {unit}".strip()
