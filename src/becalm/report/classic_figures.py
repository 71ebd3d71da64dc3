"""Make the tables and figures of a comparison of becalm with classic filters, for each channel."""

from __future__ import annotations

import numpy as np

from becalm.classic.register import CLASSICS
from becalm.cleaning.comparison import BECALM, RULES, ChannelComparison, Comparison, Contender
from becalm.cleaning.comparison_cells import cells, headings
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import judge
from becalm.core.recording import Recording
from becalm.report.data.description import Axis, Curve, Figure, Layer, Role
from becalm.report.page import Addition, Cells
from becalm.report.pictures import TIME, Title, slug_of

_ROWS = 600  # number of rows that are drawn
_RIVALS = 2  # number of classic filters that are drawn with becalm


def comparison_figures(found: Comparison, recording: Recording, truth: Recording | None = None) -> tuple[Addition, ...]:
    """Return the table and up to two figures of a comparison for each channel.

    Parameters
    ----------
    found : Comparison
        Results of all filters.
    recording : Recording
        Samples (N, m) that all filters cleaned.
    truth : Recording, optional
        True signal, N rows, with at least the compared channels.
    """
    return tuple(_channel(found, number, recording, truth) for number in range(len(found.channels)))


def _channel(found: Comparison, number: int, recording: Recording, truth: Recording | None) -> Addition:
    channel = found.channels[number]
    title = Title(slug_of(number, channel.name), channel.name, channel.unit)
    rows = tuple(cells(one, channel.unit, truth is not None) for one in channel.contenders)
    table = Cells("Compared with common filters", headings(truth is not None), rows)
    outputs, removed = _outputs(title, channel, found, recording, truth), _noise_and_lag(title, channel, found.causal)
    return Addition((table,), outputs, removed)


def _noise_and_lag(title: Title, channel: ChannelComparison, causal: bool) -> tuple[Figure, ...]:
    """Draw each contender's noise reduction against its lag; only causal filters have a lag."""
    measured = [one for one in channel.contenders if one.noise_removed_db is not None and one.lag_s is not None]
    if not causal or len(measured) < 2:
        return ()
    layers = []
    for rule in ("", *RULES):
        points = [one for one in measured if one.rule == rule]
        if points:
            late, removed = np.array([(one.lag_s, one.noise_removed_db) for one in points], dtype=np.float64).T
            role: Role = "clean" if rule == "" else "other"
            layers.append(Curve(rule or BECALM, late, removed, role, "points"))
    caption = "Up and to the left is better: more noise removed, with less lag."
    late_axis, removed_axis = Axis("lag (s)"), Axis("noise removed (dB)")
    name, shown = f"{title.slug}-contenders", "Noise removed against lag"
    return (Figure(name, shown, late_axis, removed_axis, tuple(layers), caption),)


def _outputs(
    title: Title, channel: ChannelComparison, found: Comparison, recording: Recording, truth: Recording | None
) -> tuple[Figure, ...]:
    """Draw the outputs of a few filters over some rows from the middle of the recording."""
    rivals = _rivals(channel.contenders, truth is not None)
    if not rivals:
        return ()
    start = max(0, (len(recording) - _ROWS) // 2)
    shown, step_s = slice(start, start + _ROWS), recording.timebase.step_s
    times_s = (recording.times_s - recording.times_s[0])[shown]
    z = judge(np.ascontiguousarray(recording.channel(channel.name))).readings
    layers: list[Layer] = [Curve("readings", times_s, z[shown], "readings")]
    for one in rivals:
        layers.append(Curve(f"{one.name}, {one.rule}", times_s, _output(one, z, step_s)[shown]))
    layers.append(Curve(BECALM, times_s, found.cleaned.signal.channel(channel.name)[shown], "clean"))
    if truth is not None:
        layers.append(Curve("truth", times_s, truth.channel(channel.name)[shown], "truth", "dashed"))
    caption = "Some rows from the middle of the recording."
    return (Figure(f"{title.slug}-outputs", "Side by side", TIME, Axis(title.axis), tuple(layers), caption),)


def _rivals(contenders: tuple[Contender, ...], with_truth: bool) -> list[Contender]:
    """Choose the classic filters to draw: those with the smallest rms error, or without a truth the first ones."""
    classics = [one for one in contenders if one.rule]
    if with_truth:
        errors = [np.inf if one.rms_error is None else one.rms_error for one in classics]
        classics = [classics[place] for place in np.argsort(errors, kind="stable") if np.isfinite(errors[place])]
    return classics[:_RIVALS]


def _output(one: Contender, z: Floats, step_s: float) -> Floats:
    assert one.cutoff_hz is not None  # every classic filter has a cutoff
    return CLASSICS[one.name].clean(z, one.cutoff_hz * step_s)
