"""What docstrings and the reference name is there."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
TYPED = re.compile(
    r"^ *(?:[a-z_*]\w*(?:, \w+)* : )?(?:sequence|list|tuple|dict|iterable|iterator) of ([A-Z]\w+)", re.MULTILINE
)
NAMED = re.compile(r"^ *[a-z_*]\w*(?:, \w+)* : ([A-Z]\w+)(?: or None|, optional)?$", re.MULTILINE)
OTHERS = {"Path", "Gate", "ColumnLayout", "Recording"}  # types of attributes that a module need not import


def names_of(tree: ast.Module) -> set[str]:
    """Return all names that a module defines, imports or uses."""
    nodes = list(ast.walk(tree))
    found = {node.name for node in nodes if isinstance(node, ast.ClassDef)}
    found |= {alias.asname or alias.name for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names}
    return found | {node.id for node in nodes if isinstance(node, ast.Name)}


def docstrings_of(tree: ast.Module) -> list[str]:
    kinds = ast.ClassDef, ast.FunctionDef
    return [ast.get_docstring(node) or "" for node in ast.walk(tree) if isinstance(node, kinds)]


def test_types_in_docstrings_are_those_of_the_module() -> None:
    stray, seen = [], 0
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        known = names_of(tree) | OTHERS
        told = {name for text in docstrings_of(tree) for way in (TYPED, NAMED) for name in way.findall(text)}
        seen += len(told)
        stray += [f"{path.relative_to(ROOT)}: {name}" for name in sorted(told - known)]
    assert seen > 300
    assert stray == []


def test_what_the_reference_shows_is_there() -> None:
    text = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    found = re.findall(r"auto(?:class|function):: (becalm[\w.]+)", text)
    assert len(found) > 20
    for name in found:
        module, _, thing = name.rpartition(".")
        assert hasattr(importlib.import_module(module), thing), name
