"""The command line of all benchmarks: they print their text, and with -o they also write it as a page."""

from __future__ import annotations

import argparse
from pathlib import Path


def page_parser(about: str | None) -> argparse.ArgumentParser:
    """Return a parser with the option -o; its help shows the first line of `about`, the docstring of a benchmark."""
    parser = argparse.ArgumentParser(description=(about or "").strip().partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, help="page to write to")
    return parser


def publish(title: str, about: str | None, text: str, output: Path | None) -> None:
    """Print a text; with an output, write a page of the title, the docstring `about` and the text."""
    print(text)
    if output:
        output.write_text(f"# {title}\n\n{(about or '').strip()}\n\n{text}", encoding="utf-8")
