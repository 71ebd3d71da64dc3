"""Render the templates of an export: the C code, the Makefile and the README."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

_TEMPLATES = Environment(
    loader=PackageLoader(__name__, "."),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
    autoescape=False,
)


def _grouped(expression: str) -> str:
    """Put an expression into parentheses if it is a sum or a product, or begins with a minus sign."""
    return f"({expression})" if " " in expression or expression.startswith("-") else expression


_TEMPLATES.filters["grouped"] = _grouped


def render(name: str, context: Mapping[str, Any]) -> str:
    """Return the text of a template, filled in with the values of `context`."""
    return _TEMPLATES.get_template(name).render(context)
