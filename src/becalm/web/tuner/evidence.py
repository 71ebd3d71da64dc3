"""Describe models, and how well they predict readings, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.identification.likelihood import Tuning

_ALIKE = 5e-4  # models count as equal if the relative difference of their errors is smaller
_ROUND = 0.1  # relative differences from this one on are shown in whole percent


def describe_model(channel: ChannelRecipe) -> str:
    """Return a short description of a channel's model."""
    if channel.model != "motion":
        return "passes unchanged" if channel.model == "untold" else "constant: passes unchanged"
    parts = [f"a tone at {tone.frequency_hz:.4g} Hz" for tone in channel.tone]
    parts += ["coloured noise"] if channel.coloured_noise is not None else []
    if channel.switching is not None:
        parts.append(f"the modes {' and '.join(mode.name for mode in channel.switching.mode)}")
    return f"order {channel.order}" + (f" with {', '.join(parts)}" if parts else "")


def compared_with_best(rivals: Sequence[Tuning]) -> dict[int, str]:
    """Return a sentence for each order: how much worse this model predicts readings than the best model.

    Parameters
    ----------
    rivals : sequence of Tuning
        Tunings of different orders on one record. Smoothers are compared by their loss, filters by their likelihood.
    """
    if not rivals:
        return {}
    smooths = all(np.isfinite(rival.loss) for rival in rivals)
    costs = {rival.order: _cost(rival, smooths) for rival in rivals}
    best = min(costs.values())
    what = "estimates a left-out reading" if smooths else "predicts the next reading"
    return {order: _sentence(what, float(np.expm1(cost - best))) for order, cost in costs.items()}


def _cost(rival: Tuning, smooths: bool) -> float:
    """Return the logarithm of the error of an estimated reading, up to a constant of the record."""
    return rival.loss / 2 if smooths else -rival.log_likelihood / max(rival.count, 1)


def _sentence(what: str, worse: float) -> str:
    if not worse >= _ALIKE:
        return f"{what} as well as any"
    if not worse < 100:
        return f"{what} far worse"
    return f"{what} {100 * worse:.{0 if worse >= _ROUND else 1}f} % worse"
