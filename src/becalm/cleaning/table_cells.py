"""Write the results of a channel as cells of a table."""

from __future__ import annotations

from becalm.cleaning.report import ChannelReport

_MOST_PLAIN = 1e6  # larger numbers are printed with powers of ten
_SELDOM = 0.01  # share of a record below which the bandwidth of a mode is not shown


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
