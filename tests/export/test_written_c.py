"""The C that pages show compiles: that of an export's own README, and that of the manual."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from becalm.export.bundle import ExportOptions, bundle_of
from becalm.export.proof.verifying import write_bundle
from exported import bundle, channel, need, recipe_of

ROOT = Path(__file__).parents[2]


def blocks(text: str) -> list[str]:
    """Return the blocks of C of a page."""
    found = re.findall(r"^```c\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert found
    return found


def compiled(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Compile a block beside a bundle."""
    need("cc")
    (folder / "shown.c").write_text(code, encoding="utf-8")
    words = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unused-but-set-variable", "-Wno-unused-variable"]
    return subprocess.run([*words, "-fsyntax-only", "shown.c"], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("precision", ["float32", "float64", "q31"])
def test_the_readme_of_an_export_shows_c_that_compiles(precision: str, tmp_path: Path) -> None:
    made = bundle(channel(), precision=precision, spans={"ax": (-99.0, 99.0)})
    for code in blocks(made.files["README.md"]):
        ran = compiled(code, write_bundle(made, tmp_path))
        assert ran.returncode == 0, ran.stderr


def test_the_manual_shows_c_that_compiles(tmp_path: Path) -> None:
    told = channel("load (N)", unit="N")
    made = bundle_of(recipe_of(told), "cell", ExportOptions())
    for code in blocks((ROOT / "docs" / "export.md").read_text(encoding="utf-8")):
        ran = compiled(code, write_bundle(made, tmp_path))
        assert ran.returncode == 0, ran.stderr
