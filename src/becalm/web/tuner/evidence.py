"""What speaks for a model, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.identification.likelihood import Tuning

_ALIKE = 5e-4  # of an error: less is not worth telling
_ROUND = 0.1  # from there on in whole percent


def described(channel: ChannelRecipe) -> str:
    """Say what a channel's model is."""
    if channel.model != "motion":
        return "passes unchanged" if channel.model == "untold" else "constant: passes unchanged"
    beside = [f"a tone at {tone.frequency_hz:.4g} Hz" for tone in channel.tone]
    beside += ["coloured noise"] if channel.coloured_noise is not None else []
    if channel.switching is not None:
        beside.append(f"switching between {' and '.join(mode.name for mode in channel.switching.mode)}")
    return f"order {channel.order}" + (f" with {', '.join(beside)}" if beside else "")


def beside_best(rivals: Sequence[Tuning]) -> dict[int, str]:
    """Say of each order, alone, how much worse it tells readings than the best of them.

    Parameters
    ----------
    rivals : sequence of Tuning
        Of one record; of smoothers `loss` tells, of filters the likelihood.
    """
    if not rivals:
        return {}
    smooths = all(np.isfinite(rival.loss) for rival in rivals)
    costs = {rival.order: _cost(rival, smooths) for rival in rivals}
    best = min(costs.values())
    what = "tells a reading left out" if smooths else "foretells the next reading"
    return {order: _said(what, float(np.expm1(cost - best))) for order, cost in costs.items()}


def _cost(rival: Tuning, smooths: bool) -> float:
    """Return the logarithm of the error of a reading that is told, but for a constant of the record."""
    return rival.loss / 2 if smooths else -rival.log_likelihood / max(rival.count, 1)


def _said(what: str, worse: float) -> str:
    if not worse >= _ALIKE:
        return f"{what} as well as any"
    if not worse < 100:
        return f"{what} far worse"
    return f"{what} {100 * worse:.{0 if worse >= _ROUND else 1}f} % worse"
