"""Change one operator or number of the code at a time, and see whether a test of that line fails.

First the lines that every test runs are recorded, with coverage.py:

    pip install pytest-cov
    pytest -n 2 -m "not slow" --cov=becalm --cov-branch --cov-context=test --cov-report=

Then `python benchmarks/mutations.py` draws 200 places of `core`, `identification`, `files` and `live` by a seed. In a
copy of the project it changes each in turn (`<` becomes `<=`, `+` becomes `-`, `and` becomes `or`, a condition its
opposite, a number one more) and runs up to 25 of the tests that run this line, drawn by the same seed. Changes that no
test noticed are printed: some do not change what the code does, others show a test that is missing. With `--native`
places of the kernel in C are drawn instead; it is compiled, and the fast tests of `tests/core` and `tests/export` run.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from random import Random
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGE = Path("src/becalm")
ROOMS, TESTS_OF_NATIVE = ("core", "identification", "files", "live"), ["tests/core", "tests/export"]
SEED, TESTS, TIMEOUT_S = 1, 25, 600

_OPPOSITE: dict[type[ast.AST], type[Any]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
_OF_C = {" < ": " <= ", " <= ": " < ", " > ": " >= ", " >= ": " > ", " == ": " != ", " + ": " - ", " - ": " + ",
         " * ": " / ", " && ": " || ", " || ": " && ", " += ": " -= ", " -= ": " += "}  # fmt: skip


class Mutation(NamedTuple):
    """A place in a file, and what is to stand there."""

    path: Path  # within the project
    start: int  # of the text that is replaced, in characters
    stop: int
    line: int  # of the place, from 1
    text: str

    def __str__(self) -> str:
        """Return where it is, and what it changes."""
        before = (ROOT / self.path).read_text(encoding="utf-8")[self.start : self.stop]
        return f"{self.path}:{self.line}: {' '.join(before.split())} -> {self.text}"


def _changed(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what can stand in the place of an expression or of a condition."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in _OPPOSITE:
        yield ast.Compare(node.left, [_OPPOSITE[type(node.ops[0])](), *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.BinOp) and type(node.op) in _OPPOSITE:
        yield ast.BinOp(node.left, _OPPOSITE[type(node.op)](), node.right)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(_OPPOSITE[type(node.op)](), node.values)
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        yield ast.UnaryOp(ast.Not(), node.test)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        yield ast.Constant(node.value + 1)


def _nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Walk through code that runs: not through annotations."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child
                yield from _nodes(child)


def mutations_of(path: Path) -> Iterator[Mutation]:
    """Yield every change of a Python file of the project."""
    text = (ROOT / path).read_text(encoding="utf-8")
    starts = [0]
    for row in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(row))
    rows = text.splitlines()

    def at(row: int, column: int) -> int:
        """Return the character of a place that is given in bytes of its row."""
        return starts[row - 1] + len(rows[row - 1].encode()[:column].decode())

    for node in _nodes(ast.parse(text)):
        for changed in _changed(node):
            place = node.test if isinstance(node, ast.If | ast.IfExp | ast.While) else node
            assert isinstance(place, ast.expr)
            start, stop = (at(place.lineno, place.col_offset), at(place.end_lineno or 0, place.end_col_offset or 0))
            yield Mutation(path, start, stop, place.lineno, f"({ast.unparse(changed)})")


def mutations_of_c(path: Path) -> Iterator[Mutation]:
    """Yield every change of a C file of the kernel, outside comments and macros."""
    text = (ROOT / path).read_text(encoding="utf-8")
    bare = re.sub(r"/\*.*?\*/|^#.*?[^\\]$", lambda found: " " * len(found[0]), text, flags=re.DOTALL | re.MULTILINE)
    for found in re.finditer("|".join(map(re.escape, _OF_C)), bare):
        yield Mutation(path, found.start(), found.end(), text.count("\n", 0, found.start()) + 1, _OF_C[found[0]])


def drawn(count: int, native: bool, rng: Random) -> list[Mutation]:
    """Draw changes: files by their numbers of places, as many in every room."""
    if native:
        files = sorted((ROOT / PACKAGE / "native").glob("*.[ch]"))
        every = [one for path in files for one in mutations_of_c(path.relative_to(ROOT))]
        return rng.sample(every, count)
    found = []
    for room in ROOMS:
        files = sorted((ROOT / PACKAGE / room).rglob("*.py"))
        every = [one for path in files for one in mutations_of(path.relative_to(ROOT))]
        found += rng.sample(every, count // len(ROOMS))
    return found


def tests_of(one: Mutation, rng: Random) -> list[str]:
    """Draw tests that run the line of a change; several tests of one parametrized function count as one."""
    from coverage import CoverageData  # not needed by --native

    data = CoverageData(str(ROOT / ".coverage"))
    data.read()
    lines = data.contexts_by_lineno(str(ROOT / one.path))
    of_line = {name for name in lines.get(one.line, []) if "::" in name}
    of_file = {name for contexts in lines.values() for name in contexts if "::" in name}
    contexts = of_line or of_file  # a constant of a module is in no test's line
    names = {name.partition("|")[0].partition("[")[0] for name in contexts}
    tests = {name for name in names if not name.startswith("tests/house")}  # these read the text
    return sorted(rng.sample(sorted(tests), min(TESTS, len(tests))))


def outcome(one: Mutation, copy: Path, tests: list[str]) -> str:
    """Change the copy, run the tests, change it back, and return what became of the change."""
    path, whole = copy / one.path, (ROOT / one.path).read_text(encoding="utf-8")
    path.write_text(whole[: one.start] + one.text + whole[one.stop :], encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(copy / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    run = partial(subprocess.run, cwd=copy, env=environment, capture_output=True, timeout=TIMEOUT_S)
    pytest = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow"]
    try:
        if one.path.suffix != ".py" and run([sys.executable, "hatch_build.py"], check=False).returncode:
            return "does not compile"
        return ("not noticed", "noticed")[run([*pytest, *tests], check=False).returncode != 0]
    except subprocess.TimeoutExpired:
        return "took too long"
    finally:
        path.write_text(whole, encoding="utf-8")


def main() -> None:
    """Draw changes, try each, and print how many were noticed and which were not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--native", action="store_true", help="change the kernel in C")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    rng, outcomes = Random(asked.seed), Counter[str]()
    places = drawn(asked.count, asked.native, rng)
    tests = [TESTS_OF_NATIVE if asked.native else tests_of(one, rng) for one in places]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(asked.jobs) as pool:
        copies: SimpleQueue[Path] = SimpleQueue()
        for number in range(asked.jobs):
            ignored = shutil.ignore_patterns(".venv", ".git", "__pycache__", ".*_cache", ".coverage*")
            copies.put(Path(shutil.copytree(ROOT, Path(folder, str(number), ROOT.name), ignore=ignored)))

        def attempt(one: Mutation, tests: list[str]) -> str:
            """Try one change in a copy that nobody else uses."""
            copy = copies.get()
            try:
                return outcome(one, copy, tests) if tests else "no test runs it"
            finally:
                copies.put(copy)

        for one, what in zip(places, pool.map(attempt, places, tests), strict=True):
            outcomes[what] += 1
            if what != "noticed":
                print(f"{what}: {one}", flush=True)
    print(", ".join(f"{count} {what}" for what, count in outcomes.most_common()))


if __name__ == "__main__":
    main()
