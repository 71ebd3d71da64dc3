"""Compiling ahead: each kernel is named when it is ready, then where they are kept."""

from __future__ import annotations

import time

from becalm.cli.talk import stderr
from becalm.errors import OutputError

_WAY_OUT = "Set NUMBA_CACHE_DIR to a folder that can be written, and repeat."


def run() -> None:
    """Compile the kernels, unless they are there already; say so on stderr."""
    begun = time.perf_counter()
    from becalm.core.compiling import kernel_folder, require_compiler
    from becalm.core.warming import warm

    require_compiler()
    folder, made = kernel_folder(), 0
    if folder is None:
        raise OutputError(
            "Compiled kernels cannot be kept: neither the package's folder nor the user's cache can be written."
            f" becalm works, but compiles anew in every process. {_WAY_OUT}"
        )
    for kernel in warm():
        if kernel.trouble is not None:
            raise OutputError(f"Compiled kernels cannot be kept in {folder}: {kernel.trouble}. {_WAY_OUT}")
        if kernel.compiled:
            made += 1
            states = f"{kernel.states} state{'s' * (kernel.states > 1)}"
            stderr.print(f"{kernel.name}, {states}: compiled in {kernel.seconds:.1f} s")
    took = time.perf_counter() - begun
    if made:
        stderr.print(f"Compiled {made} kernels in {took:.1f} s; they are kept in {folder}.")
    else:
        stderr.print(f"All kernels were compiled already ({took:.1f} s); they are kept in {folder}.")
