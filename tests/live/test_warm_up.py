"""What a stream needs is compiled before its first row, in a thread beside all else."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from becalm.cleaning import stream, warm_up
from becalm.core import kernel_gate, kernel_lag
from stream_recipes import CAUSAL, KINDS, LAGGED, RATE_HZ, recipe_of, rough, streamed

KERNELS: list[Any] = [kernel_gate.find_outliers, kernel_lag.open_window, kernel_lag.run_late, kernel_lag.run_out]


@pytest.mark.parametrize("how", [CAUSAL, LAGGED], ids=["causal", "lagged"])
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_left_to_compile(kind: str, how: dict[str, Any]) -> None:
    recipe = recipe_of(KINDS[kind], **how)
    warm_up.warm_up(recipe, 1 / RATE_HZ)
    before = [len(kernel.signatures) for kernel in KERNELS]
    streamed(stream.StreamCleaner(recipe, 1 / RATE_HZ), rough(900)[:, np.newaxis], np.ones(900), [10, 500])
    assert [len(kernel.signatures) for kernel in KERNELS] == before


LOOK = """
import threading
import numpy as np
import becalm.core.kernel_lag
from numba.core.typing.typeof import typeof_impl
from becalm.core.components import motion
from becalm.core.online import Online
before = set(typeof_impl.registry)
online = Online(motion(1).to_model(1.0, 1.0))
threads = [threading.Thread(target=Online(motion(n).to_model(1.0, 1.0)).run, args=(np.arange(9.0),)) for n in (1, 2)]
for thread in threads:
    thread.start()
online.run(np.arange(9.0))
for thread in threads:
    thread.join()
print(len(set(typeof_impl.registry) - before))
"""


def test_a_first_call_tells_numba_no_kind_of_value_that_another_thread_may_be_looking_for() -> None:
    ran = subprocess.run([sys.executable, "-c", LOOK], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "0"
    assert ran.stderr == ""
