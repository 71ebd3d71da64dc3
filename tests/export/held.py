"""Filters in fixed point that tests hold in this process, as a library of C."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from becalm.cleaning.recipe import ChannelRecipe
from becalm.export.bundle import Bundle
from becalm.export.proof.compiling import STRICT
from becalm.export.proof.verifying import unpacked
from exported import bundle, need

UNDEFINED = ("-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all")
"""Under which undefined behaviour ends the program."""

SPAN = 2.0**15


def fixed(*told: ChannelRecipe, span: tuple[float, float] = (-SPAN, SPAN)) -> Bundle:
    """Write these channels in fixed point; a span is for those that have no rails."""
    railed = [one.name for one in told if one.limits is not None and one.limits.low is not None]
    return bundle(*told, precision="q31", spans={one.name: span for one in told if one.name not in railed})


def library(folder: Path, source: str, *flags: str) -> ctypes.CDLL:
    """Compile one file of a folder, strictly."""
    need("cc")
    made = folder / "library.so"
    subprocess.run(["cc", *STRICT, *flags, "-shared", "-fPIC", str(folder / source), "-o", str(made)], check=True)
    return ctypes.CDLL(str(made))


class Held:
    """The one filter of a bundle."""

    def __init__(self, made: Bundle, folder: Path, *flags: str) -> None:
        (self.one,) = made.channels
        unpacked(made, folder)
        self._library = library(folder, f"{made.stem}.c", *flags)
        self._state = ctypes.create_string_buffer(self.one.written.state_bytes)

    def call(self, name: str, *words: Any) -> None:
        """Call a function of it."""
        getattr(self._library, f"{self.one.prefix}_{name}")(self._state, *words)

    def block(self, counts: ArrayLike) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Take readings (N,); return the signal and the statuses."""
        raw = np.ascontiguousarray(counts, np.int32)
        told, codes = np.empty_like(raw), np.empty(len(raw), np.uint8)
        pointers = [ctypes.c_void_p(each.ctypes.data) for each in (raw, told, codes)]
        self.call("step_block", *pointers, ctypes.c_size_t(len(raw)))
        return told, codes

    def level(self, digits: int) -> float:
        """Return its first state, in counts."""
        return int(np.frombuffer(self._state.raw[:8], np.int64)[0]) / 2.0**digits
