"""Write the results of a channel as cells of a table."""

from __future__ import annotations

from becalm.cleaning.report import ChannelReport

_MOST_PLAIN = 1e6  # from which on numbers are told by powers of ten
_SELDOM = 0.01  # share of a record, below which a mode's bandwidth is not told


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
    """Say its bandwidth, or from which to which those of its modes reach."""
    if report.modes:
        return _between([mode.bandwidth_hz for mode in report.modes.values() if mode.share >= _SELDOM], "Hz")
    return amount(report.bandwidth_hz, "Hz")


def _lag(report: ChannelReport, causal: bool) -> str:
    """Say by how much its output trails, or how long it waits."""
    if report.delay_s is not None:
        return f"told {amount(report.delay_s, 's')} later"
    if report.modes and causal:  # a still mode's is never waited for: it is left first
        moving = {name: mode for name, mode in report.modes.items() if name != "still"}
        name = max(moving, key=lambda name: moving[name].share)
        return f"{amount(moving[name].lag_s, 's')} while {name}"
    return amount(report.lag_s, "s") if causal else "none"


def _trust(report: ChannelReport) -> str:
    """Say whether the model describes the signal."""
    if report.verdict == "fits except":
        return f"except near {amount(report.loudest_hz, 'Hz')}"
    return {"fits": "yes", "does not fit": "no"}.get(report.verdict, "see below")


def _model(report: ChannelReport) -> str:
    """Say what the signal is modelled as."""
    if report.order is None:
        return report.model
    if report.modes:
        return "switching: " + ", ".join(f"{name} {mode.share:.0%}" for name, mode in report.modes.items())
    told = [f"{report.model} of order {report.order}"]
    for what, frequencies in (("tones at", report.tones_hz), ("without", report.removed_hz)):
        if frequencies:
            told.append(f"{what} {', '.join(f'{frequency:.4g}' for frequency in frequencies)} Hz")
    if report.coloured_std is not None:
        told.append(f"without coloured noise of {amount(report.coloured_std, report.unit)}")
    return ", ".join(told)


def _between(values: list[float | None], unit: str) -> str:
    told = sorted(value for value in values if value is not None)
    alone = not told or told[0] == told[-1]
    return amount(told[0] if told else None, unit) if alone else f"{told[0]:.3g} to {amount(told[-1], unit)}"


def amount(value: float | None, unit: str) -> str:
    """Return a value with its unit; a dash where there is none."""
    if value is None:
        return "-"
    nothing = unit in ("s", "Hz") and abs(value) < 1e-12
    told = f"{0.0 if nothing else value:.3g}"
    plain = f"{float(told):.0f}" if "e+0" in told and abs(value) < _MOST_PLAIN else told
    return f"{plain} {unit}".strip()
