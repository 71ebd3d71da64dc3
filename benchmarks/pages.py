"""What every benchmark's command line shares: its text goes to the terminal, and with -o onto a page."""

from __future__ import annotations

import argparse
from pathlib import Path


def page_parser(about: str | None) -> argparse.ArgumentParser:
    """Return a parser with -o; `about` is the benchmark's own docstring, whose first line it shows."""
    parser = argparse.ArgumentParser(description=(about or "").strip().partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, help="page to write to")
    return parser


def publish(title: str, about: str | None, text: str, output: Path | None) -> None:
    """Print a text; with an output, write it as a page with a title, below what the benchmark is about."""
    print(text)
    if output:
        output.write_text(f"# {title}\n\n{(about or '').strip()}\n\n{text}", encoding="utf-8")
