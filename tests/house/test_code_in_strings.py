"""Programs that tests and benchmarks hold as text import names that exist; no type checker reads them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = "tests", "benchmarks", "docs"
FILES = sorted({file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py")} - {Path(__file__)})


def programs(file: Path) -> Iterator[ast.Module]:
    """Parse each string of a file that is a program and speaks of becalm."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and "import " in node.value:
            try:
                yield ast.parse(node.value)
            except SyntaxError:  # prose, or another language
                continue


def imports(program: ast.Module) -> Iterator[tuple[str, str]]:
    """Name what a program imports of becalm: a module, and a name in it or nothing."""
    for node in ast.walk(program):
        if isinstance(node, ast.Import):
            yield from ((one.name, "") for one in node.names if one.name.split(".")[0] == "becalm")
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "becalm":
            yield from ((node.module, one.name) for one in node.names)


def exists(module: str, name: str) -> bool:
    try:
        found = import_module(module)
        return not name or hasattr(found, name) or find_spec(f"{module}.{name}") is not None
    except ModuleNotFoundError:  # nor is the module, or it is no package
        return False


def test_programs_in_strings_import_what_there_is() -> None:
    named = [(file, *one) for file in FILES for program in programs(file) for one in imports(program)]
    assert len(named) > 20
    assert [(str(file.relative_to(ROOT)), *one) for file, *one in named if not exists(*one)] == []


@pytest.mark.parametrize(
    "text", ["from becalm.core.rows import nobody", "from becalm.core import nobody", "import becalm.nowhere"]
)
def test_an_import_of_nothing_is_found(text: str) -> None:
    assert not all(exists(*one) for one in imports(ast.parse(text)))
