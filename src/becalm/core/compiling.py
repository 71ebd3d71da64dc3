"""How kernels are compiled: once per user, kept on disk, free of the interpreter's lock, nothing allocated."""

from __future__ import annotations

import functools
import gc
import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numba.core.ccallback  # these two tell Numba kinds of values when they are first imported, which else ...
import numba.experimental.function_type  # ... is in the midst of a first call, while another thread may look them up
from numba import njit
from numba.core import config, serialize
from numba.core.caching import CompileResultCacheImpl
from numba.core.compiler import CompileResult

from becalm.errors import UsageError

_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract"},  # a * b + c in one rounding; NaN and the order of sums stay
    "_nrt": False,
    "no_cfunc_wrapper": True,
}

_PART: dict[str, Any] = {"no_cpython_wrapper": True, "forceinline": True}

_SEAL = 32  # bytes of a SHA-256
_CONFIG: Any = config
_RESULT: Any = CompileResult
_DUMPS: Any = serialize.dumps
_BESIDE = Path(__file__).parent / "__pycache__"
_SEALED = ("kernel*", "sized", "small", "compiling")  # modules that kernels are made of


def _mark_sources() -> bytes:
    """Return a mark of all that kernels are made of; an upgrade or an edit changes it."""
    here = Path(__file__).parent
    mark = hashlib.sha256(numba.__version__.encode())
    for file in sorted(file for name in _SEALED for ending in ("py", "pyc") for file in here.glob(f"{name}.{ending}")):
        mark.update(file.read_bytes())
    return mark.digest()


_SOURCES = _mark_sources()  # before a kernel is imported: of an edit meanwhile nothing is kept under a wrong name

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(function: Kernel) -> Kernel:
    """Compile a kernel on its first call.

    Kernels get their scratch arrays from the stack or from the caller, so reference counting is left
    out (`_nrt`): it would take half of their time and of their compilation.
    """
    return _compile(function, _OPTIONS)


def compiled_part(function: Kernel) -> Kernel:
    """Compile a step that only other kernels call, into each of them.

    Inlined, its small arrays become registers; a door from Python would cost a quarter of the compilation.
    It is kept as well: a second kernel is then compiled in half of the time.
    """
    return _compile(function, _OPTIONS | _PART)


def woven(function: Kernel) -> Kernel:
    """Weave a function into the source of the kernels that call it, so that it may return arrays of their stack."""
    return _compile(function, _OPTIONS | {"inline": "always"})


def _compile(function: Kernel, options: dict[str, Any]) -> Kernel:
    if _CONFIG.DISABLE_JIT:
        return cast(Kernel, functools.wraps(function)(_refuse))
    dispatcher = njit(**options)(function)
    package, _, module = function.__module__.rpartition(".")
    if package == __package__ and any(fnmatch(module, name) for name in _SEALED):  # of others the seal knows no sources
        dispatcher._cache = Shelf(function)
    return cast(Kernel, dispatcher)


def require_compiler() -> None:
    """Raise a UsageError where Numba may not compile."""
    if _CONFIG.DISABLE_JIT:
        _refuse()


def compile_quickly() -> None:
    """Look for cycles of garbage seldom in this process: a compiler makes none to speak of, but much to look at."""
    gc.set_threshold(200_000, 50, 50)


def _refuse(*_arguments: object, **_named: object) -> object:
    raise UsageError(
        "NUMBA_DISABLE_JIT is set, but becalm's kernels exist only compiled. Unset it and repeat:"
        " env -u NUMBA_DISABLE_JIT ..."
    )


class Shelf:
    """What one kernel was compiled to, in a file for each kind of arguments; stands in for Numba's own cache.

    Numba's looks only at the file of the kernel itself, not at the kernels that are compiled into it;
    two processes can tear its index; and what it cannot read or write ends the program. Here a file is
    sealed with the sources of all kernels: it is whole and of these sources, or is made anew. Where
    none can be written the program goes on, quietly, and compiles anew each time; `becalm warm` says so.
    """

    def __init__(self, function: Callable[..., object]) -> None:
        name = f"{function.__module__}.{function.__qualname__}".replace(".<locals>", "")
        self._stem = f"{name}.{sys.implementation.cache_tag}"
        self._held = repr([cell.cell_contents for cell in function.__closure__ or ()])
        self.folder = kernel_folder()
        self.trouble: OSError | None = None

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return what was kept for a signature, or None."""
        target.refresh()
        name = self._name(signature, target.codegen())
        for folder in (self.folder, _BESIDE):  # what an administrator compiled may be read by all
            if folder is None:
                continue
            try:
                stored = (folder / name).read_bytes()
                if stored[:_SEAL] == _seal(stored[_SEAL:]):
                    return _RESULT._rebuild(target, *pickle.loads(stored[_SEAL:]))
            except Exception:  # whatever is wrong with what was kept: compile it
                continue
        return None

    def save_overload(self, signature: Any, made: Any) -> None:
        """Keep what was compiled for a signature, whole or not at all."""
        if self.folder is None:
            return
        body = _DUMPS(made._reduce())
        try:
            _write(self.folder / self._name(signature, made.codegen), _seal(body) + body)
        except OSError as cause:
            self.trouble = cause

    def _name(self, signature: Any, codegen: Any) -> str:
        kind = repr((signature, codegen.magic_tuple(), self._held))
        return f"{self._stem}.{hashlib.sha256(kind.encode()).hexdigest()[:16]}.nbc"

    def count(self) -> int:
        """Return how many kinds are kept, made of these sources."""
        return sum(
            stored[:_SEAL] == _seal(stored[_SEAL:])
            for folder in {self.folder, _BESIDE}
            if folder is not None
            for stored in (file.read_bytes() for file in folder.glob(f"{self._stem}.*.nbc"))
        )

    @property
    def cache_path(self) -> str | None:
        """The folder, as Numba's statistics show it."""
        return None if self.folder is None else str(self.folder)

    def flush(self) -> None:
        """Forget all that was kept of this kernel."""
        for file in self.folder.glob(f"{self._stem}.*.nbc") if self.folder else ():
            file.unlink(missing_ok=True)


def _write(file: Path, content: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f"{file.name}.{os.getpid()}")
    try:
        part.write_bytes(content)
        part.replace(file)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise


def _seal(body: bytes) -> bytes:
    return hashlib.sha256(_SOURCES + body).digest()


@functools.cache
def kernel_folder() -> Path | None:
    """Return NUMBA_CACHE_DIR, the package's __pycache__, or the user's cache; None where none can be written."""
    place: Any = CompileResultCacheImpl
    if _is_homeless():  # then Numba would make a folder called ~
        others = [locator for locator in place._locator_classes if "UserWide" not in locator.__name__]
        place = type("_Place", (place,), {"_locator_classes": others})
    try:
        return Path(place(_refuse).locator.get_cache_path())
    except (RuntimeError, OSError):
        return None


def _is_homeless() -> bool:
    try:
        return "XDG_CACHE_HOME" not in os.environ and not Path.home().is_absolute()
    except RuntimeError:  # no HOME, and nobody knows this user
        return True


def save_trouble(kernel: object) -> OSError | None:
    """Return why a compiled kernel could not be kept; None where it was, or nothing was to be kept."""
    shelf = getattr(kernel, "_cache", None)
    return shelf.trouble if isinstance(shelf, Shelf) else None


def times_compiled(kernel: object) -> int:
    """Return for how many kinds of arguments a kernel was compiled in this process, and not found on disk."""
    stats = getattr(kernel, "stats", None)
    return 0 if stats is None else sum(stats.cache_misses.values())
