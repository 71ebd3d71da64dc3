"""Run the code blocks of the pages, and write their output into the text blocks that follow them.

    python docs/blocks.py    # update the pages

All blocks of a page run in the same namespace and folder. A shell block runs only if all its lines are commands of
becalm. The tests run all pages, and fail if an output differs from the page.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from contextlib import chdir, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

DOCS = Path(__file__).parent
ROOT = DOCS.parent
PAGES = (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))

_BLOCK = re.compile(
    r"^```(?P<kind>python|sh)\n(?P<code>.*?)^```\n(?P<output>\n```text\n(?P<text>.*?)^```\n)?", re.M | re.S
)
_COLUMNS = "110"


def has_blocks(page: Path) -> bool:
    """Return whether a page has a block to run."""
    return any(_runs(block) for block in _BLOCK.finditer(page.read_text(encoding="utf-8")))


def rewritten(page: Path, folder: Path) -> str:
    """Run the blocks of a page in a folder; return the page with their output.

    Raises
    ------
    RuntimeError
        If a command fails; an exception of a Python block is raised unchanged.
    """
    names: dict[str, Any] = {"__name__": "__main__"}

    def with_output(block: re.Match[str]) -> str:
        if not _runs(block):
            return block[0]
        printed = _python(block["code"], names, page) if block["kind"] == "python" else _commands(block["code"])
        if block["output"] is None:
            return block[0]
        return f"```{block['kind']}\n{block['code']}```\n\n```text\n{printed.rstrip()}\n```\n"

    with chdir(folder):
        return _BLOCK.sub(with_output, page.read_text(encoding="utf-8"))


def _runs(block: re.Match[str]) -> bool:
    """Return whether a block runs: Python, or becalm's commands; commands that need a reader's files are in `bash`."""
    return block["kind"] == "python" or all(line.startswith("becalm ") for line in block["code"].splitlines())


def _python(code: str, names: dict[str, Any], page: Path) -> str:
    with redirect_stdout(StringIO()) as printed:
        exec(compile(code, str(page), "exec"), names)
    return printed.getvalue()


def _commands(code: str) -> str:
    printed = []
    for line in code.splitlines():
        command = [sys.executable, "-m", "becalm", *shlex.split(line, comments=True)[1:]]
        env = {**os.environ, "COLUMNS": _COLUMNS, "NO_COLOR": "1"}
        ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False, env=env)
        if ran.returncode:
            raise RuntimeError(f"`{line}` ends with {ran.returncode}: {ran.stdout}")
        printed.append(ran.stdout)
    return "".join(line.rstrip() + "\n" for line in "".join(printed).splitlines())


if __name__ == "__main__":
    for each in filter(has_blocks, PAGES):
        with TemporaryDirectory() as empty:
            text = rewritten(each, Path(empty))
        if text != each.read_text(encoding="utf-8"):
            each.write_text(text, encoding="utf-8")
            print(f"Wrote {each.relative_to(ROOT)} anew.")
