"""All kernels that cleaning, tuning and live filters of one channel use, compiled ahead of their first use."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from becalm.core.compiling import save_trouble, times_compiled
from becalm.core.components import motion
from becalm.core.filtering import kalman_filter, sizes_of
from becalm.core.kernel_backward import backward
from becalm.core.kernel_online import live_kernels
from becalm.core.kernels import forward
from becalm.core.online import Online
from becalm.core.smoothing import kalman_smoother

ORDERS = (1, 2, 3)
_READINGS = np.linspace(0.0, 1.0, 100)


class Warmed(NamedTuple):
    """What became of one kernel."""

    name: str
    order: int
    seconds: float
    compiled: bool  # False where it was there already
    trouble: OSError | None  # why it could not be kept


def warm() -> Iterator[Warmed]:
    """Compile the kernels for motions of order 1, 2, 3 with one channel, one after the other."""
    for order in ORDERS:
        model = motion(order).to_model(step_s=1.0, noise_variance=1.0)
        online = Online(model)
        live = live_kernels(*sizes_of(model))
        yield _warmed("forward", order, forward, partial(kalman_filter, model, _READINGS))
        yield _warmed("backward", order, backward, partial(kalman_smoother, model, _READINGS))
        yield _warmed("live run", order, live.run, partial(online.run, _READINGS))
        yield _warmed("live step", order, live.step, partial(online.step, 1.0))


def _warmed(name: str, order: int, kernel: object, use: Callable[[], object]) -> Warmed:
    before, begun = times_compiled(kernel), time.perf_counter()
    use()
    took, compiled = time.perf_counter() - begun, times_compiled(kernel) > before
    return Warmed(name, order, took, compiled, save_trouble(kernel))
