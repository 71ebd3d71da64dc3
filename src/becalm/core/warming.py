"""The kernels of lags and of `becalm.kalman_filter`, for one channel, compiled ahead.

Compiling is slow, and one process compiles one kernel at a time; so each number of states has a process of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from becalm.core.compiling import compile_quickly, save_trouble, times_compiled
from becalm.core.components import HIGHEST_ORDER, Component, motion, returning_motion
from becalm.core.filtering import kalman_filter, sizes_of
from becalm.core.fixed_lag import fixed_lag_smoother
from becalm.core.gatekeeper import Gatekeeper
from becalm.core.gates import LEAST_THRESHOLD, Gate
from becalm.core.itself import MODULE, environment
from becalm.core.kernel_backward import backward
from becalm.core.kernel_gate import find_outliers
from becalm.core.kernel_lag import run_late
from becalm.core.kernel_online import live_kernels
from becalm.core.kernels import forward
from becalm.core.model import Model
from becalm.core.online import Online
from becalm.core.smoothing import kalman_smoother
from becalm.core.timeline import even_timeline
from becalm.errors import UsageError

EVERY_SIZE = tuple(range(1, HIGHEST_ORDER + 2))
"""Numbers of states of a motion: its order, and one more where it returns to a level."""

KERNELS = ("forward", "backward", "gate", "late", "live run", "live step")

Use = tuple[object, Callable[[], object]]

_READINGS = np.linspace(0.0, 1.0, 100)


class Warmed(NamedTuple):
    """What became of one kernel."""

    name: str
    states: int
    seconds: float
    compiled: bool  # False where it was there already
    trouble: str | None  # why it could not be kept


def warm(names: Sequence[str] = KERNELS, sizes: Sequence[int] = EVERY_SIZE) -> Iterator[Warmed]:
    """Compile the kernels for motions of some numbers of states with one channel, side by side.

    A tone counts as two states more.

    Raises
    ------
    UsageError
        If a process came to grief; what it has not compiled is compiled when it is used.
    """
    waiting, running = list(sizes), deque[subprocess.Popen[str]]()
    codes: list[int] = []
    try:
        while waiting or running:
            while waiting and len(running) < (os.cpu_count() or 1):
                running.append(_start(waiting.pop(0), names))
            assert running[0].stdout is not None, "stdout=PIPE gives it"
            for line in running[0].stdout:
                yield Warmed(*json.loads(line))
            running[0].stdout.close()
            codes.append(running[0].wait())
            running.popleft()
        if any(codes):
            raise UsageError(
                f"Compiling ahead ended with exit code {max(codes, key=abs)}; kernels are compiled when they are first"
                f" used. To see why: {' '.join(MODULE)} {__name__} 1 {KERNELS[0]}"
            )
    finally:
        for process in running:
            process.kill()
            process.communicate()


def _start(states: int, names: Sequence[str]) -> subprocess.Popen[str]:
    """Compile for one number of states in a process of its own."""
    return subprocess.Popen(
        [*MODULE, __name__, str(states), *names],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment(),
        text=True,
    )


def warm_size(states: int, names: Sequence[str]) -> Iterator[Warmed]:
    """Compile kernels for a motion of so many states in this process, one after the other."""
    uses = _uses_of_motion(states)
    for name in names:
        if name in uses:
            yield _warmed(name, states, *uses[name])


def _motion(states: int) -> Component:
    return motion(states) if states <= HIGHEST_ORDER else returning_motion(states - 1, 1.0, 0.1)


def _uses_of_motion(states: int) -> dict[str, Use]:
    model = _motion(states).to_model(step_s=1.0, noise_variance=1.0)
    online = Online(model)
    live = live_kernels(*sizes_of(model))
    return {
        "forward": (forward, partial(kalman_filter, model, _READINGS)),
        "backward": (backward, partial(kalman_smoother, model, _READINGS)),
        "gate": (find_outliers, partial(_judge, model)),
        "late": (run_late, partial(fixed_lag_smoother, model, _READINGS, 1)),
        "live run": (live.run, partial(online.run, _READINGS)),
        "live step": (live.step, partial(online.step, 1.0)),
    }


def _judge(model: Model) -> None:
    belief = np.concatenate([np.zeros(model.states), np.eye(model.states).ravel()])
    timeline = even_timeline(model, len(_READINGS))
    Gatekeeper(model, Gate(LEAST_THRESHOLD)).judge(timeline, _READINGS[:, np.newaxis], 0, belief)


def _warmed(name: str, states: int, kernel: object, use: Callable[[], object]) -> Warmed:
    before, begun = times_compiled(kernel), time.perf_counter()
    use()
    took, compiled = time.perf_counter() - begun, times_compiled(kernel) > before
    trouble = save_trouble(kernel)
    return Warmed(name, states, took, compiled, None if trouble is None else trouble.strerror)


if __name__ == "__main__":
    compile_quickly()
    for one in warm_size(int(sys.argv[1]), sys.argv[2:]):
        print(json.dumps(one), flush=True)  # noqa: T201  (read by `warm`)
