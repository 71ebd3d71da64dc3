"""Write the page of all commands from the help texts of the command line.

python docs/commands.py    # update docs/commands.md
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).parent / "commands.md"


def written() -> str:
    """Return the up-to-date text of the page."""
    typer = [sys.executable, "-m", "typer", "becalm.cli.main", "utils", "docs"]
    command = [*typer, "--name", "becalm", "--title", "Commands"]
    ran = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True)
    return ran.stdout.rstrip() + "\n"


if __name__ == "__main__":
    PAGE.write_text(written(), encoding="utf-8")
