"""Compute the verdict and the figures of a channel's report over the whole record; a new request interrupts this."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from becalm.cleaning.channels.excerpt import ChannelRows
from becalm.cleaning.channels.judging import Decision
from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.report.channel import CleanedChannels, Pictured, Pictures
from becalm.report.data.payload import payload
from becalm.report.gathering import Gathering

_CHUNK = 1 << 18  # rows between two checks for an interruption

_TONES: dict[Decision, str] = {"fits": "fits", "constant": "fits", "fits except": "except", "does not fit": "not"}
_DIGITS = 4  # significant digits of the numbers


def judge_channel(
    rows: ChannelRows, recipe: Recipe, channel: ChannelRecipe, number: int, wanted: Callable[[], bool]
) -> dict[str, Any] | None:
    """Clean a whole channel, and draw the figures of its report.

    Parameters
    ----------
    rows : ChannelRows
        Readings of the channel.
    recipe : Recipe
        Recipe of the recording.
    channel : ChannelRecipe
        Recipe of the channel.
    number : int
        Number of the channel, from 0.
    wanted : callable
        Function that returns whether the result is still wanted.

    Returns
    -------
    dict or None
        The message "figures" for a page; None if the result is no longer wanted.
    """
    recipe_of_one = recipe.model_copy(update={"channel": (channel,)})
    gathering = Gathering(len(rows), rows.step_s, 1)
    waiting: list[slice] = []
    with Cleaner(recipe_of_one, rows.step_s, innovation_callbacks=[gathering.channels[0].add_innovations]) as cleaner:
        for start in range(0, len(rows), _CHUNK):
            if not wanted():
                return None
            part = slice(start, min(start + _CHUNK, len(rows)))
            waiting.append(part)
            for estimates in cleaner.push([rows.z[part]], rows.elapsed[part]):
                done = waiting.pop(0)
                gathering.add([rows.z[done]], rows.elapsed[done], estimates)
        for estimates in cleaner.finish():
            done = waiting.pop(0)
            gathering.add([rows.z[done]], rows.elapsed[done], estimates)
        reports = cleaner.reports()
    if not wanted():
        return None
    drawn = Pictures(CleanedChannels(recipe_of_one, reports, gathering, rows.step_s)).channel(0)
    return _message(drawn, number) if wanted() else None


def _message(drawn: Pictured, number: int) -> dict[str, Any]:
    lanes = [figure for figure in drawn.wide if figure.name.endswith("-verdicts")]
    figures = [*drawn.narrow, *lanes]
    return {
        "kind": "figures",
        "channel": number,
        "tone": _TONES.get(drawn.report.verdict, ""),
        "says": drawn.report.says,
        "numbers": _numbers(drawn),
        "payload": json.loads(payload(figures)),
        "captions": {figure.name: figure.says for figure in figures},
    }


def _numbers(drawn: Pictured) -> list[list[str]]:
    """Return those numbers of the report that are known: pairs of a name and a text."""
    report = drawn.report
    values = [
        ("noise of a reading", report.noise_std, report.unit),
        ("coloured noise", report.coloured_std, report.unit),
        ("bandwidth", report.bandwidth_hz, "Hz"),
        ("lag", report.lag_s, "s"),
        ("delay", report.delay_s, "s"),
        ("errors independent after", report.independence_s, "s"),
        ("still predictable", None if report.predictable_share is None else 100 * report.predictable_share, "%"),
        ("NIS, 1 is right", report.nis_mean, ""),
        ("sigma wider for the tuning by", None if not report.tuning_spread else 100 * report.tuning_spread, "%"),
    ]
    numbers = [
        [term, f"{value:.{_DIGITS}g} {unit}".strip()]
        for term, value, unit in values
        if value is not None and np.isfinite(value)
    ]
    return numbers + [[name, f"{count} readings"] for name, count in report.verdicts.items() if count]
