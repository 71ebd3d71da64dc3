"""Kernels that tuning needs, compiled before it begins."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress

from becalm.core.compiling import compile_quickly, kernel_folder, require_compiler
from becalm.core.recording import Recording
from becalm.core.warming import OF_ALL, is_cold, warm
from becalm.errors import UsageError
from becalm.noise.choose import sizes_run


def compile_ahead(recording: Recording, *, causal: bool, tell: Callable[[str], object]) -> None:
    """Compile side by side what tuning would compile one after the other, if it was never done.

    Parameters
    ----------
    recording : Recording
        What will be tuned on.
    causal : bool
        Whether it is tuned for filtering.
    tell : callable
        Is told that it takes a while, where it does.

    Raises
    ------
    UsageError
        If Numba may not compile.
    """
    require_compiler()
    compile_quickly()
    names = ("forward", *(() if causal else ("backward",)), *OF_ALL)
    sizes = sizes_run(causal)
    if kernel_folder() is not None and is_cold(names, sizes):
        tell("Compiling the filters for this machine, which is done once and takes some minutes.")
        with suppress(UsageError):  # then they are compiled when they are used
            deque(warm(names, sizes), maxlen=0)
