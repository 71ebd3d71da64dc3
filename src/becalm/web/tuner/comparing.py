"""Run a classic filter for comparison, at the cut-off that gives it the noise gain of the channel's filter."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from becalm.classic.matching import equal_noise
from becalm.classic.register import CLASSICS
from becalm.cleaning.channels.excerpt import ChannelRows
from becalm.core.reading_verdicts import judge
from becalm.errors import UsageError
from becalm.report.data.envelope import Envelope
from becalm.web.tuner.picture import View

_SETTLED = 12.0  # settling time of the slowest filter in rows, times its cut-off in cycles per row
_DIGITS = 3  # significant digits of a noise gain, so that similar gains need only one search for a cut-off
_MIDDLE = 0.1  # cut-off in cycles per row, for filters whose noise gain cannot be matched


def run_classic(rows: ChannelRows, view: View, name: str, noise_gain: float | None) -> Envelope:
    """Run a classic filter over a view.

    Parameters
    ----------
    rows : ChannelRows
        Readings of the channel; impossible readings count as missing.
    view : View
        Rows to show.
    name : str
        Name of the classic filter.
    noise_gain : float or None
        Noise gain of the channel's filter, output variance over input variance of white noise; None if unknown.

    Raises
    ------
    UsageError
        If there is no such filter.
    """
    classic = CLASSICS.get(name)
    if classic is None:
        raise UsageError(f"There is no classic filter {name!r}; choose one from the list.")
    gain = None if noise_gain is None or not 0 < noise_gain < 1 else float(f"{noise_gain:.{_DIGITS}g}")
    cutoff = _MIDDLE if gain is None or not classic.reduces_noise else _cutoff(name, gain)
    margin = int(_SETTLED / cutoff) + 64
    first, stop = max(0, view.first - margin), min(len(rows), view.stop + (0 if classic.causal else margin))
    z = judge(np.ascontiguousarray(rows.z[first:stop])).readings
    signal = classic.clean(z, cutoff)[view.first - first :][: view.stop - view.first]
    return Envelope.of(np.ascontiguousarray(signal), view.width)


@lru_cache(maxsize=256)
def _cutoff(name: str, gain: float) -> float:
    return equal_noise(CLASSICS[name], gain)
