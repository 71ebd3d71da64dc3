"""Compile and run exported C with the compilers of this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from becalm.errors import BecalmError, UsageError
from becalm.export.shared_parts import FOLDER

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror", "-ffp-contract=off")
"""Flags with which the filters compile without a warning."""

OPTIMISED = (("-O0",), ("-O2",), ("-O3",), ("-O3", "-ffast-math"))  # additional flags of each build
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")

_ENDING, _MATHEMATICS = (".exe", ()) if os.name == "nt" else ("", ("-lm",))  # of programs, and their library
_LONGEST_S = 600.0  # time limit of one run of a compiler or a program, in seconds
_REPORT = "This is a fault in becalm: leave --verify out, and report it with the recipe."


class CompileError(BecalmError):
    """An error for exported C that does not compile or run, or does not agree with becalm."""

    exit_code = 1


class Build(NamedTuple):
    """A compiled program that runs the filters of a bundle.

    Attributes
    ----------
    compiler : str
        Name of the compiler.
    flags : tuple of str
        Flags in addition to `STRICT`.
    program : Path
        Path of the program.
    """

    compiler: str
    flags: tuple[str, ...]
    program: Path


def compilers() -> list[str]:
    """Return the names of the installed C compilers: gcc and clang, or else cc.

    Raises
    ------
    UsageError
        If no C compiler is installed.
    """
    names = [name for name in ("gcc", "clang") if shutil.which(name)] or ["cc"] * bool(shutil.which("cc"))
    if not names:
        raise UsageError("No C compiler was found: there is no gcc, clang or cc; install one.")
    return names


def version_of(compiler: str) -> str:
    """Return the first line that a compiler prints for --version."""
    return _run_checked([compiler, "--version"], "the compiler's version").stdout.splitlines()[0]


def build(folder: Path, stem: str, compiler: str, flags: Sequence[str]) -> Build:
    """Compile the filters of a bundle with the flags `STRICT`, and link the program that runs them.

    Parameters
    ----------
    folder : Path
        Folder of the bundle.
    stem : str
        Prefix of the bundle's file names.
    compiler : str
        Name of the compiler.
    flags : sequence of str
        Flags in addition to `STRICT`.

    Raises
    ------
    CompileError
        If the compiler reports a warning or an error.
    UsageError
        If the compiler cannot be run.
    """
    mark = f"{compiler}{''.join(flags)}".replace("=", "").replace(",", "")
    texts = [folder / f"{stem}.c", *sorted(folder.glob(f"{FOLDER}/*.c")), folder / "main.c"]
    objects = [folder / f"{mark}-{text.parent.name if text.parent != folder else ''}-{text.stem}.o" for text in texts]
    for text, made in zip(texts, objects, strict=True):
        extra = STRICT[:1] if text == texts[-1] else STRICT
        _run_checked([compiler, *extra, *flags, "-c", str(text), "-o", str(made)], text.name)
    program = folder / f"{mark}-check{_ENDING}"
    _run_checked([compiler, *flags, *map(str, objects), "-o", str(program), *_MATHEMATICS], "the program")
    return Build(compiler, tuple(flags), program)


def run(build: Build, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the program of a build with arguments; the caller checks its exit code."""
    return _run_limited([str(build.program), *words])


def _run_checked(words: Sequence[str], what: str) -> subprocess.CompletedProcess[str]:
    ran = _run_limited(words)
    if ran.returncode != 0:
        output = " ".join((ran.stderr or ran.stdout).split())[:600]
        raise CompileError(f"{words[0]} does not make {what} of what becalm exported: {output}. {_REPORT}")
    return ran


def _run_limited(words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            list(words), capture_output=True, encoding="utf-8", errors="replace", check=False, timeout=_LONGEST_S
        )
    except OSError as cause:
        raise UsageError(
            f"{words[0]} cannot be run ({cause.strerror}); repair it, or set TMPDIR to a folder whose programs may run."
        ) from cause
    except subprocess.TimeoutExpired as cause:
        raise CompileError(
            f"{words[0]} did not end within {_LONGEST_S:.0f} s. Export fewer channels at once."
        ) from cause
