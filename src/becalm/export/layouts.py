"""Write a bundle's additional layouts: for an emulated Cortex-M, for Arduino, and a block as in CMSIS-DSP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from becalm.export.templates import render

_FIXED_PATHS = {
    "cortex_m/startup.c": "cortex_m/startup.c.jinja",
    "cortex_m/link.ld": "cortex_m/link.ld.jinja",
    "cortex_m/counting.c": "cortex_m/counting.c.jinja",
    "examples/cmsis_block.c": "cmsis_block.c.jinja",
}


def layouts(context: Mapping[str, Any], native: Mapping[str, str]) -> dict[str, str]:
    """Return the texts of all layouts, by their paths in a bundle.

    Parameters
    ----------
    context : mapping
        Values for the bundle's templates, including `vectors_hash`.
    native : mapping of str to str
        Texts of the library's C sources by path; empty if no filter needs them.
    """
    library = library_name(context["stem"])
    within = {**context, "library": library, "library_version": _library_version(context["version"])}
    root, stem = f"arduino/{library}", context["stem"]
    arduino = {
        f"{root}/library.properties": "arduino/library.properties.jinja",
        f"{root}/keywords.txt": "arduino/keywords.txt.jinja",
        f"{root}/src/becalm.h": "becalm.h.jinja",
        f"{root}/src/{stem}.h": "header.h.jinja",
        f"{root}/src/{stem}.c": "source.c.jinja",
        f"{root}/examples/{library}Live/{library}Live.ino": "arduino/live.ino.jinja",
    }
    return {path: render(template, within) for path, template in (_FIXED_PATHS | arduino).items()} | {
        f"{root}/src/{path}": text for path, text in native.items()
    }


def library_name(stem: str) -> str:
    """Return the name of the Arduino library: `test_bench` becomes `TestBench`."""
    return "".join(part.capitalize() for part in stem.split("_"))


def _library_version(version: str) -> str:
    """Return the first three numbers of a version, for Arduino; a missing number becomes 0."""
    numbers = [*version.split("+")[0].split("."), "0", "0", "0"][:3]
    return ".".join(number if number.isdigit() else "0" for number in numbers)
