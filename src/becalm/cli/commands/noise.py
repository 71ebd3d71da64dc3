"""Measure the noise of a recording at rest; print tables on stderr, and with --json JSON on stdout."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from becalm.cleaning.noise_report import ChannelNoise, report_noise
from becalm.cli.messages import print_notes, progress, stderr
from becalm.errors import UsageError
from becalm.files.inputs.portions import explain_rest_errors, read_beginning, unused_rows_note

if TYPE_CHECKING:
    from becalm.cleaning.allan_figures import AllanNoise, Coefficient, QuotedCoefficient
    from becalm.files.inputs.opening import OpenSource

    Spans = Sequence[tuple[float, float]]

_CUTOFF_HZ = 1.0  # default of --cutoff, from the IMU paper
_STRETCHES = 12  # largest number of rests in a message

_wide = Console(stderr=True, highlight=False, soft_wrap=True, markup=False, width=1000)  # wide: no number wraps


def run(source: OpenSource, spans_s: Spans | None, cutoff_hz: float | None, as_json: bool) -> None:
    """Print the noise of a file at rest; the rests are given, or detected if `spans_s` is None.

    Raises
    ------
    UsageError
        If a given rest has too few rows, or the cut-off is not below half of the rate.
    """
    if cutoff_hz is not None and cutoff_hz >= source.rate_hz / 2:
        raise UsageError(
            f"--cutoff {cutoff_hz:g}Hz is too high for a rate of {source.rate_hz:.4g} Hz; give less than half of that."
        )
    print_notes(source)
    recording = read_beginning(source)
    with progress("measuring", len(source.names)) as step, explain_rest_errors(source, recording):
        noises = report_noise(
            recording,
            still=spans_s,
            cutoff_hz=cutoff_hz or _CUTOFF_HZ,
            progress=lambda name: step(name, 1),
        )
    if as_json:
        summary = {
            "file": str(source.path),
            "rows": source.rows,
            "rows_looked_at": len(recording),
            "rate_hz": source.rate_hz,
            "channels": [channel.as_dict() for channel in noises],
        }
        print(json.dumps(summary, indent=2))  # noqa: T201
    _show(noises)
    if cut := unused_rows_note(source, recording):
        stderr.print(cut.strip())


def _show(noises: tuple[ChannelNoise, ...]) -> None:
    """Print the rests, R and the Allan figures; then sentences on unknown or doubtful figures."""
    first = noises[0]
    stderr.print(first.rest)
    if first.stretches_s:
        stderr.print(f"At rest: {_spans(first.stretches_s)}.")
    stderr.print()
    _wide.print(_noise_table(noises))
    with_allan = [(channel.name, channel.allan) for channel in noises if channel.allan is not None]
    if with_allan:
        stderr.print(f"\nAllan deviation, over the longest rest, {_span(with_allan[0][1].stretch_s)} s:")
        _wide.print(_allan_table(with_allan))
    stderr.print()
    for sentence, names in _names_by_sentence(noises).items():
        everyone = len(noises) > 1 and len(names) == len(noises)
        stderr.print(f"{'All channels' if everyone else ', '.join(names)}: {sentence}")
    if not first.stretches_s:
        stderr.print(
            "If the sensor does lie still, give the rests with --still START:STOP, in seconds after the first row."
            " Measure channels that do not rest together one by one with --channels NAME."
        )
    else:
        stderr.print("Noise at rest is a lower bound: vibration of a sensor in use is not in it.")


def _names_by_sentence(noises: tuple[ChannelNoise, ...]) -> dict[str, list[str]]:
    """Return, by sentence, the names of the channels that it concerns."""
    names: dict[str, list[str]] = {}
    for channel in noises:
        for sentence in channel.says:
            names.setdefault(sentence, []).append(channel.name)
    return names


def _noise_table(noises: tuple[ChannelNoise, ...]) -> Table:
    cutoff = f"{noises[0].cutoff_hz:g} Hz"
    table = _table("channel", "noise", "std error", f"above {cutoff}", f"below {cutoff}", "unit")
    for channel in noises:
        figures = (channel.noise_std, channel.noise_std_error, channel.above_std, channel.below_std)
        table.add_row(channel.name, *map(_number, figures), channel.unit)
    return table


def _allan_table(with_allan: list[tuple[str, AllanNoise]]) -> Table:
    table = _table("channel", "Allan figure", "value", "std error", "unit", "in data-sheet units")
    for name, allan in with_allan:
        for row, cells in enumerate(_allan_rows(allan)):
            table.add_row("" if row else name, *cells)
    return table


def _allan_rows(allan: AllanNoise) -> Iterator[tuple[str, ...]]:
    named = (
        ("N, white noise", allan.white_noise),
        ("B, bias instability", allan.bias_instability),
        ("K, random walk", allan.random_walk),
    )
    for name, one in named:
        yield name, _number(one.value), _number(one.standard_error), one.unit, _quotes(one)
    unit = allan.bias_instability.unit
    square = f"({unit})^2" if "/" in unit else f"{unit}^2" if unit else ""
    yield "R = N^2 rate", _number(allan.noise_variance), "", square, ""
    yield "q = K^2", _number(allan.random_walk_density), "", f"{square or 1}/s", ""


def _quotes(one: Coefficient) -> str:
    """Return the text of a coefficient in units of data sheets; of its upper limit if its value is unknown."""
    if one.value is None:
        bounds: Sequence[QuotedCoefficient | Coefficient] = one.quoted or (one,)
        return ", ".join(f"below {_number(bound.limit)} {bound.unit}".strip() for bound in bounds)
    return ", ".join(f"{_number(quoted.value)} {quoted.unit}" for quoted in one.quoted)


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False)
    left = ("channel", "unit", "Allan figure", "in data-sheet units")
    for heading in headings:
        table.add_column(heading, justify="left" if heading in left else "right")
    return table


def _spans(spans_s: Spans) -> str:
    named = ", ".join(map(_span, spans_s[:_STRETCHES]))
    more = f" and {len(spans_s) - _STRETCHES} more" if len(spans_s) > _STRETCHES else ""
    return f"{named} s{more}"


def _span(span_s: tuple[float, float]) -> str:
    return ":".join(f"{round(time_s, 2):.10g}" for time_s in span_s)


def _number(value: float | None) -> str:
    """Return a number with three significant digits; below a million, large numbers have no exponent."""
    return "-" if value is None else f"{float(f'{value:.3g}'):g}"
