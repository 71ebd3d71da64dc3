"""Which tests to run after an edit: those that changed, and those that import what changed.

    python tests/changed.py [BASE]    # print their files; BASE is what git compares with, HEAD by default

Where no test imports a module, those of the modules that do come in its place. Of many tests the first `MOST` are
printed, those in the folder of the module's room before others; how many are left out is said.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

TESTS = Path(__file__).parent
ROOT = TESTS.parent
SRC = ROOT / "src"
MOST = 12  # files of tests: a minute's work


@cache
def imports_below(folder: Path, pattern: str) -> dict[Path, set[str]]:
    """Return the modules of becalm that each file below a folder names in its imports."""
    return {file: imported_by(file) for file in folder.rglob(pattern)}


def imported_by(file: Path) -> set[str]:
    """Return the modules of becalm that a file names in its imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
    return {name for name in names if name.startswith("becalm.")}


def module_of(file: Path) -> str:
    """Return the module that a file of the sources is."""
    inside = file.relative_to(SRC)
    return ".".join(inside.parent.parts if file.stem == "__init__" else inside.with_suffix("").parts)


def importers(modules: Iterable[str], files: dict[Path, set[str]]) -> set[Path]:
    """Return the files that import one of some modules."""
    wanted = set(modules)
    return {file for file, names in files.items() if names & wanted}


def tests_of(file: Path) -> list[Path]:
    """Return the test files to run after a file has changed, the nearest first."""
    tests = imports_below(TESTS, "test_*.py")
    if file in tests:
        return [file]
    if not file.is_relative_to(SRC):
        return []
    room = file.relative_to(SRC / "becalm").parts[0]
    found = {each for each in tests if each.stem == f"test_{file.stem}"}
    if file.suffix == ".py":
        sources, modules = imports_below(SRC, "*.py"), {module_of(file)}
        for _ in range(3):  # how far from a test a module may be
            if near := importers(modules, tests):
                found |= near
                break
            modules = {module_of(each) for each in importers(modules, sources)}
    if file.suffix != ".py" or not found:  # a page's script, C, a template, what is loaded by its name: its room
        found |= {each for each, names in tests.items() if any(name.startswith(f"becalm.{room}") for name in names)}
    return sorted(found, key=lambda each: (each.parent.name != room, each))


def changed_since(base: str) -> list[Path]:
    """Return the files that differ from a commit, and those that git does not know yet."""
    found: list[Path] = []
    for command in (["diff", "--name-only", "--diff-filter=d", base], ["ls-files", "--others", "--exclude-standard"]):
        ran = subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=True)
        found += [ROOT / line for line in ran.stdout.splitlines()]
    return found


if __name__ == "__main__":
    wanted = list(dict.fromkeys(test for file in changed_since(*(sys.argv[1:] or ["HEAD"])) for test in tests_of(file)))
    for test in wanted[:MOST]:
        print(test.relative_to(ROOT))
    if len(wanted) > MOST:
        print(f"{len(wanted) - MOST} more files of tests import what changed; make fast runs all.", file=sys.stderr)
