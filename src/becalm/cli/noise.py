"""The noise of a recording at rest, for a person on stderr and as JSON on stdout."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from becalm.cleaning.noise_report import ChannelNoise, report_noise
from becalm.cli.messages import progress, stderr, tell_notes
from becalm.errors import UsageError
from becalm.files.portions import beginning, cut_short, rest_within

if TYPE_CHECKING:
    from becalm.cleaning.allan_figures import AllanNoise, Coefficient, Quoted
    from becalm.files.opening import OpenSource

    Spans = Sequence[tuple[float, float]]

_CUTOFF_HZ = 1.0  # of the IMU paper, where none is said
_STRETCHES = 12  # that are named one by one

_wide = Console(stderr=True, highlight=False, soft_wrap=True, markup=False, width=1000)  # breaks no figure


def run(source: OpenSource, spans_s: Spans | None, cutoff_hz: float | None, as_json: bool) -> None:
    """Find rest in a file, or take it as said, and tell the noise there.

    Raises
    ------
    UsageError
        If a stretch that was said holds too few rows, or the cut-off is beyond half of the rate.
    """
    if cutoff_hz is not None and cutoff_hz >= source.rate_hz / 2:
        raise UsageError(
            f"--cutoff {cutoff_hz:g}Hz cannot be had at {source.rate_hz:.4g} rows a second; stay below half of that."
        )
    tell_notes(source)
    recording = beginning(source)
    with progress("measuring", len(source.names)) as step, rest_within(source, recording):
        told = report_noise(
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
            "channels": [channel.as_dict() for channel in told],
        }
        print(json.dumps(summary, indent=2))  # noqa: T201
    _show(told)
    if cut := cut_short(source, recording):
        stderr.print(cut.strip())


def _show(told: tuple[ChannelNoise, ...]) -> None:
    """Show stretches, R, Allan figures; then what is not known, and why."""
    first = told[0]
    stderr.print(first.rest)
    if first.stretches_s:
        stderr.print(f"At rest: {_spans(first.stretches_s)}.")
    stderr.print()
    _wide.print(_noise_table(told))
    known = [(channel.name, channel.allan) for channel in told if channel.allan is not None]
    if known:
        stderr.print(f"\nAllan deviation, over the longest rest, {_span(known[0][1].stretch_s)} s:")
        _wide.print(_allan_table(known))
    stderr.print()
    for sentence, names in _said_of(told).items():
        everyone = len(told) > 1 and len(names) == len(told)
        stderr.print(f"{'All channels' if everyone else ', '.join(names)}: {sentence}")
    if not first.stretches_s:
        stderr.print(
            "Where the sensor does lie still, say so: --still START:STOP, in seconds after the first row. Channels that"
            " do not rest together are looked at one by one with --channels NAME."
        )
    else:
        stderr.print("Noise at rest is the least there is: what shakes a sensor in use is not in it.")


def _said_of(told: tuple[ChannelNoise, ...]) -> dict[str, list[str]]:
    """Return each sentence with the channels that it is about."""
    said: dict[str, list[str]] = {}
    for channel in told:
        for sentence in channel.says:
            said.setdefault(sentence, []).append(channel.name)
    return said


def _noise_table(told: tuple[ChannelNoise, ...]) -> Table:
    cutoff = f"{told[0].cutoff_hz:g} Hz"
    table = _table("channel", "noise", "std error", f"above {cutoff}", f"below {cutoff}", "unit")
    for channel in told:
        figures = (channel.noise_std, channel.noise_std_error, channel.above_std, channel.below_std)
        table.add_row(channel.name, *map(_number, figures), channel.unit)
    return table


def _allan_table(known: list[tuple[str, AllanNoise]]) -> Table:
    table = _table("channel", "Allan figure", "value", "std error", "unit", "as a data sheet has it")
    for name, allan in known:
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
    """Write a coefficient as data sheets do; of one that is not told, what it does not exceed."""
    if one.value is None:
        bounds: Sequence[Quoted | Coefficient] = one.quoted or (one,)
        return ", ".join(f"below {_number(bound.limit)} {bound.unit}".strip() for bound in bounds)
    return ", ".join(f"{_number(quoted.value)} {quoted.unit}" for quoted in one.quoted)


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False)
    left = ("channel", "unit", "Allan figure", "as a data sheet has it")
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
    """Write three digits, and no exponent below a million."""
    return "-" if value is None else f"{float(f'{value:.3g}'):g}"
