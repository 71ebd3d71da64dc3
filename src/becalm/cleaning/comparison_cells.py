"""Write the results of a comparison as cells of a table."""

from __future__ import annotations

from becalm.cleaning.comparison import Contender

_HEADINGS = ("filter", "setting", "at", "noise removed", "lag", "overshoot", "rms error", "lag found")
_WITHOUT_TRUTH = 6  # number of columns that need no true signal; they are the first ones
_ROUNDING = 1e-9  # in the unit of the cell: smaller magnitudes are rounding errors and are shown as 0


def headings(with_truth: bool) -> tuple[str, ...]:
    """Return the names of the columns; without a true signal, the columns that need one are left out."""
    return _HEADINGS if with_truth else _HEADINGS[:_WITHOUT_TRUTH]


def cells(contender: Contender, unit: str, with_truth: bool) -> tuple[str, ...]:
    """Return the cells of a contender, one for each heading."""
    row = (
        contender.name,
        "" if contender.cutoff_hz is None else f"{contender.cutoff_hz:.4g} Hz",
        contender.rule,
        _formatted(contender.noise_removed_db, "{:.1f} dB"),
        _formatted(contender.lag_s, "{:.4g} s"),
        _formatted(contender.overshoot_percent, "{:.0f} %"),
        _formatted(contender.rms_error, "{:.4g} " + unit).rstrip(),
        _formatted(contender.measured_lag_s, "{:.4g} s"),
    )
    return row[: len(headings(with_truth))]


def _formatted(value: float | None, form: str) -> str:
    return "" if value is None else form.format(0.0 if abs(value) < _ROUNDING else value)
