"""Write the results of a comparison as cells of a table."""

from __future__ import annotations

from becalm.cleaning.comparison import Contender

_HEADINGS = ("filter", "setting", "at", "noise removed", "lag", "overshoot", "rms error", "lag found")
_WITHOUT_TRUTH = 6  # of them
_NOTHING = 1e-9  # of whatever unit: rounding


def headings(with_truth: bool) -> tuple[str, ...]:
    """Name the columns; what only truth tells is left out without it."""
    return _HEADINGS if with_truth else _HEADINGS[:_WITHOUT_TRUTH]


def cells(contender: Contender, unit: str, with_truth: bool) -> tuple[str, ...]:
    """Return the cells of a contender, one a heading."""
    told = (
        contender.name,
        "" if contender.cutoff_hz is None else f"{contender.cutoff_hz:.4g} Hz",
        contender.rule,
        _told(contender.noise_removed_db, "{:.1f} dB"),
        _told(contender.lag_s, "{:.4g} s"),
        _told(contender.overshoot_percent, "{:.0f} %"),
        _told(contender.rms_error, "{:.4g} " + unit).rstrip(),
        _told(contender.measured_lag_s, "{:.4g} s"),
    )
    return told[: len(headings(with_truth))]


def _told(value: float | None, form: str) -> str:
    return "" if value is None else form.format(0.0 if abs(value) < _NOTHING else value)
