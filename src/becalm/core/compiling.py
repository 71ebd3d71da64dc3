"""How kernels are compiled: cached per user, free of the interpreter's lock, nothing allocated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(function: Kernel) -> Kernel:
    """Compile a kernel on its first call.

    Kernels get their scratch arrays from the caller, so reference counting is left out (`_nrt`):
    it would take half of their time and of their compilation.
    """
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}
    kernel: Kernel = njit(**options)(function)
    return kernel
