"""C compiled and run, by whatever compilers this machine has."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from becalm.errors import BecalmError, UsageError
from becalm.export.written import FOLDER

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror", "-ffp-contract=off")
"""Under which the filters compile without a word."""

OPTIMISED = (("-O0",), ("-O2",), ("-O3",), ("-O3", "-ffast-math"))
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")

_LONGEST_S = 600.0
_REPORT = "That is a fault of becalm's: leave --verify out, and report it with the recipe."


class CompileError(BecalmError):
    """What was exported does not compile, or does not do what becalm does: a fault of becalm's."""

    exit_code = 1


class Build(NamedTuple):
    """A program that runs the filters of a bundle.

    Attributes
    ----------
    compiler : str
        Its name.
    flags : tuple of str
        Beside the strict ones.
    program : Path
        What was built.
    """

    compiler: str
    flags: tuple[str, ...]
    program: Path


def compilers() -> list[str]:
    """Return the C compilers that are here.

    Raises
    ------
    UsageError
        If there is none.
    """
    found = [name for name in ("gcc", "clang") if shutil.which(name)] or ["cc"] * bool(shutil.which("cc"))
    if not found:
        raise UsageError("There is no C compiler here: none of gcc, clang and cc is found; install one.")
    return found


def version_of(compiler: str) -> str:
    """Return what a compiler calls itself."""
    return _ran([compiler, "--version"], "the compiler's version").stdout.splitlines()[0]


def build(folder: Path, stem: str, compiler: str, flags: Sequence[str]) -> Build:
    """Compile the filters of a bundle, strictly, and what runs them.

    Parameters
    ----------
    folder : Path
        Where the bundle is.
    stem : str
        What its files begin with.
    compiler : str
        Its name.
    flags : sequence of str
        Beside the strict ones.

    Raises
    ------
    CompileError
        If it does not compile without a warning.
    """
    mark = f"{compiler}{''.join(flags)}".replace("=", "").replace(",", "")
    texts = [folder / f"{stem}.c", *sorted(folder.glob(f"{FOLDER}/*.c")), folder / "main.c"]
    objects = [folder / f"{mark}-{text.parent.name if text.parent != folder else ''}-{text.stem}.o" for text in texts]
    for text, made in zip(texts, objects, strict=True):
        extra = STRICT[:1] if text == texts[-1] else STRICT
        _ran([compiler, *extra, *flags, "-c", str(text), "-o", str(made)], text.name)
    program = folder / f"{mark}-check"
    _ran([compiler, *flags, *map(str, objects), "-o", str(program), "-lm"], "the program")
    return Build(compiler, tuple(flags), program)


def run(build: Build, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a program; what it returns is looked at by the caller."""
    return _in_time([str(build.program), *words])


def _ran(words: Sequence[str], what: str) -> subprocess.CompletedProcess[str]:
    ran = _in_time(words)
    if ran.returncode != 0:
        said = " ".join((ran.stderr or ran.stdout).split())[:600]
        raise CompileError(f"{words[0]} does not make {what} of what becalm exported: {said}. {_REPORT}")
    return ran


def _in_time(words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(list(words), capture_output=True, text=True, check=False, timeout=_LONGEST_S)
    except OSError as cause:
        raise UsageError(
            f"{words[0]} cannot be run ({cause.strerror}); mend it, or set TMPDIR to a folder whose programs may run."
        ) from cause
    except subprocess.TimeoutExpired as cause:
        raise CompileError(
            f"{words[0]} did not end within {_LONGEST_S:.0f} s. Export fewer channels at once."
        ) from cause
