"""The report of one channel: its filter, the faults of its sensor, and whether to trust the result."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from becalm.cleaning.faults import Fault
from becalm.cleaning.judging import Judgement


@dataclass(frozen=True)
class ModeReport:
    """One mode of a filter with several modes.

    Attributes
    ----------
    share : float
        Mean probability of the mode over the rows.
    bandwidth_hz, lag_s : float or None
        Those of a filter with this mode alone, in steady state.
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
        As in the recording.
    model : str
        "motion", "constant" or "untold".
    order : int or None
        Order of the motion model.
    tones_hz, removed_hz : tuple of float
        Frequencies of tones: of the signal, and of disturbances that were removed.
    noise_std, coloured_std : float or None
        Standard deviation of one reading's white noise (with several modes: in the first one), and of its coloured
        noise, in unit.
    q_over_r : float or None
        Process noise density over the noise variance of a reading, with time in steps.
    bandwidth_hz, lag_s : float or None
        -3 dB bandwidth and lag, as in `becalm.core.steady.response.Response`.
    delay_s : float or None
        Lag of a filter that waits for later readings; bandwidth_hz and lag_s are None then.
    independence_s : float or None
        How far apart samples must be for their errors to count as independent: the mean over T seconds has
        the random uncertainty sigma sqrt(independence_s / T), and never more than sigma.
    tuning_spread : float or None
        Share by which sigma is larger because the tuning is uncertain.
    calibration_std : float or None
        Standard uncertainty (k = 1) of the calibration, at the mean magnitude of the signal, in unit. Averaging does
        not reduce it. None if the recipe has no calibration.
    timing_share : float or None
        Largest share by which sigma grows for an uncertain time of readings; None where the recipe has no timing.
    modes : dict of str to ModeReport
        Modes of a filter with several modes, which has neither one bandwidth nor one lag.
    log_likelihood : float or None
        Log-likelihood of the readings, given the recipe.
    settled_row : int or None
        First row with the steady-state gain.
    verdicts : dict
        How often each verdict was given, by its name: "used", "missing" and so on.
    advice : tuple of str
        What to do about these verdicts.
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

_MOST_PLAIN = 1e6  # larger numbers are printed with powers of ten
_SELDOM = 0.01  # mean probability of a mode below which its bandwidth is not shown


def cells(report: ChannelReport, causal: bool) -> tuple[str, ...]:
    """Return the cells of a channel: model, noise, bandwidth, lag, and whether its model describes the signal."""
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
        return _between([mode.bandwidth_hz for mode in report.modes.values() if mode.share >= _SELDOM], "Hz")
    return amount(report.bandwidth_hz, "Hz")


def _lag(report: ChannelReport, causal: bool) -> str:
    """Return the lag of a causal filter, or the delay of one that waits for later readings."""
    if report.delay_s is not None:
        return f"delayed {amount(report.delay_s, 's')}"
    if report.modes and causal:  # the lag of the still mode does not matter: the filter leaves that mode first
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


def _between(values: list[float | None], unit: str) -> str:
    known = sorted(value for value in values if value is not None)
    single = not known or known[0] == known[-1]
    return amount(known[0] if known else None, unit) if single else f"{known[0]:.3g} to {amount(known[-1], unit)}"


def amount(value: float | None, unit: str) -> str:
    """Return a value with its unit; a dash where there is none."""
    if value is None:
        return "-"
    rounded = unit in ("s", "Hz") and abs(value) < 1e-12
    text = f"{0.0 if rounded else value:.3g}"
    plain = f"{float(text):.0f}" if "e+0" in text and abs(value) < _MOST_PLAIN else text
    return f"{plain} {unit}".strip()
