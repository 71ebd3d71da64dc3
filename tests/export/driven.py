"""Exported filters held in this process, as a library of C: what needs single steps, gaps, resets, and what they know.

Whole records go through the program of the bundle, `exported.through`.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Codes, Floats
from becalm.export.bundle import Bundle, Exported
from becalm.export.kind import Raw
from becalm.export.proof.compiling import STRICT
from becalm.export.proof.verifying import write_bundle
from becalm.export.shared_parts import FOLDER
from exported import need

UNDEFINED = ("-O0", "-fsanitize=undefined", "-fno-sanitize-recover=all")
"""Under which undefined behaviour ends the program."""

_REAL: dict[str, Any] = {"float32": ctypes.c_float, "float64": ctypes.c_double, "q31": ctypes.c_int32}


class Told(NamedTuple):
    """What is told of some rows."""

    signal: Floats  # (N,) in unit
    codes: Codes  # (N,)
    modes: Floats  # (N, M): how probable each mode was; (N, 0) where it switches between none


class Driven:
    """One filter of a bundle; it begins as `_init` leaves it.

    Parameters
    ----------
    c : ctypes.CDLL
        The bundle, compiled.
    one : Exported
        Which of its filters.
    """

    def __init__(self, c: ctypes.CDLL, one: Exported) -> None:
        self.one, self._c = one, c
        self._real = _REAL[one.kind.number.precision]
        self.size = int(self._function("size", ctypes.c_size_t)())
        self._state = ctypes.create_string_buffer(self.size)
        pointer, real = ctypes.c_void_p, ctypes.POINTER(self._real)
        self._init = self._function("init", None, pointer)
        self._reset = self._function("reset", None, pointer, self._real)
        self._gap = self._function("gap", None, pointer, ctypes.c_uint32)
        self._step = self._function("step", ctypes.c_int, pointer, self._real, real)
        self._block = self._function("step_block", None, *[pointer] * 4, ctypes.c_size_t)
        self.init()

    def _function(self, name: str, told: Any, *taken: Any) -> Any:
        found = getattr(self._c, f"{self.one.prefix}_{name}")
        found.restype, found.argtypes = told, taken
        return found

    def init(self) -> None:
        self._init(self._state)

    def reset(self, signal: float) -> None:
        """Begin at a signal, in what C is given."""
        self._reset(self._state, signal)

    def gap(self, rows: int) -> None:
        self._gap(self._state, rows)

    @property
    def state(self) -> bytes:
        """All that it remembers."""
        return self._state.raw

    @property
    def sigma(self) -> float:
        """Of its signal, where it is the library's channel."""
        return float(self._function("sigma", self._real, ctypes.c_void_p)(self._state))

    def block(self, raw: ArrayLike) -> tuple[Raw, Codes]:
        """Take numbers (N,) as C is given them; return what it tells, and the statuses."""
        given = np.ascontiguousarray(raw, self.one.kind.number.dtype)
        told, codes = np.empty_like(given), np.empty(len(given), np.uint8)
        self._block(self._state, *(array.ctypes.data for array in (given, told, codes)), len(given))
        return told, codes.astype(np.int8)

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        """Take readings (N,) in unit at once; return the signal in unit, and the statuses."""
        told, codes = self.block(self.one.kind.raw(readings, self.one.written))
        return self.one.kind.in_unit(told, self.one.written), codes

    def steps(self, readings: Floats) -> Told:
        """Take readings (N,) in unit one by one, and ask after each how probable the modes are."""
        raw, signal = self.one.kind.raw(readings, self.one.written), self._real()
        many = 0 if self.one.design.modes is None else len(self.one.design.modes.modes)
        ask = self._function("probability", self._real, ctypes.c_void_p, ctypes.c_uint32) if many else None
        told, codes, modes = np.empty_like(raw), np.empty(len(raw), np.int8), np.empty((len(raw), many))
        for row, value in enumerate(raw.tolist()):
            codes[row] = self._step(self._state, value, ctypes.byref(signal))
            told[row] = signal.value
            modes[row] = [ask(self._state, mode) for mode in range(many)] if ask else []
        return Told(self.one.kind.in_unit(told, self.one.written), codes, modes)

    def rounded(self, readings: Floats) -> Floats:
        """Return readings (N,) in unit, as the numbers that C is given hold them."""
        return self.one.kind.in_unit(self.one.kind.raw(readings, self.one.written), self.one.written)

    def called(self, name: str) -> Any:
        """Return a function of one number, of the type of readings, that was compiled with it."""
        return self._function(name, self._real, self._real)


def library(made: Bundle, folder: Path, *flags: str, more: str = "", compiler: str = "cc") -> ctypes.CDLL:
    """Compile the filters of a bundle, strictly, with `PREFIX_size` of each and with more C, and load them."""
    need(compiler)
    place = write_bundle(made, Path(tempfile.mkdtemp(dir=folder)))
    sizes = [
        f"size_t {one.prefix}_size(void);\nsize_t {one.prefix}_size(void) {{ return sizeof({one.prefix}_state); }}\n"
        for one in made.channels
    ]
    (place / "driven.c").write_text(f'#include "{made.stem}.c"\n{"".join(sizes)}{more}', encoding="utf-8")
    loaded = [flag for flag in flags if flag != "-ffast-math"]  # linked with it, all of this process would round so
    texts = ["driven.c", *(f"{FOLDER}/{path.name}" for path in sorted(place.glob(f"{FOLDER}/*.c")))]
    objects = [text.replace("/", "-").replace(".c", ".o") for text in texts]
    words = [[*STRICT, *flags, "-fPIC", "-c", text, "-o", one] for text, one in zip(texts, objects, strict=True)]
    words += [[*loaded, "-shared", *objects, "-o", "driven.so", "-lm"]]
    for each in words:
        subprocess.run([compiler, *each], cwd=place, check=True)
    return ctypes.CDLL(str(place / "driven.so"))


def driven(made: Bundle, folder: Path, *flags: str, more: str = "", compiler: str = "cc") -> dict[str, Driven]:
    """Compile a bundle, at -O2 unless said otherwise; return its filters by the names of their channels."""
    c = library(made, folder, *(flags or ("-O2",)), more=more, compiler=compiler)
    return {one.name: Driven(c, one) for one in made.channels}


def driven_one(made: Bundle, folder: Path, *flags: str, more: str = "", compiler: str = "cc") -> Driven:
    """Compile a bundle of one filter; return that."""
    (one,) = driven(made, folder, *flags, more=more, compiler=compiler).values()
    return one
