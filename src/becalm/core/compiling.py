"""How kernels are compiled: cached per user, free of the interpreter's lock, nothing allocated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract"},  # a * b + c in one rounding; NaN and the order of sums stay
    "_nrt": False,
    "no_cfunc_wrapper": True,
}

_PART: dict[str, Any] = {"no_cpython_wrapper": True, "forceinline": True}

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(function: Kernel) -> Kernel:
    """Compile a kernel on its first call.

    Kernels get their scratch arrays from the stack or from the caller, so reference counting is left
    out (`_nrt`): it would take half of their time and of their compilation.
    """
    compile_now: Callable[[Kernel], Kernel] = njit(**_OPTIONS)
    return compile_now(function)


def compiled_part(function: Kernel) -> Kernel:
    """Compile a step that only other kernels call, into each of them.

    Inlined, its small arrays become registers; a door from Python would cost a quarter of the compilation.
    """
    compile_now: Callable[[Kernel], Kernel] = njit(**_OPTIONS, **_PART)
    return compile_now(function)


def woven(function: Kernel) -> Kernel:
    """Weave a function into the source of the kernels that call it, so that it may return arrays of their stack."""
    compile_now: Callable[[Kernel], Kernel] = njit(**_OPTIONS, inline="always")
    return compile_now(function)
