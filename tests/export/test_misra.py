"""What cppcheck's MISRA addon reports of each kind of filter: what the page lists, and nothing else."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from becalm.cleaning.recipes.recipe_parts import GateRecipe
from becalm.export.bundle import Bundle
from becalm.export.number_type import Precision
from becalm.export.proof.verifying import write_bundle
from exported import LIMITS, MODES, SPAN, TONE, bundle, channel, need

TONAL, SLOW = channel("ax", 2, 0.05, tone=(TONE,)), channel("ay", 1, 1e-3)
GATED = channel("ax", 2, 0.05, gate=GateRecipe(), limits=LIMITS)
SWITCHING = channel("ay", 2, 0.05, switching=MODES, limits=LIMITS)
MADE: dict[str, Callable[[Precision], Bundle]] = {
    "settled": lambda precision: bundle(TONAL, SLOW, precision=precision, gain="settled"),
    "full": lambda precision: bundle(channel("az", 2, 0.0), GATED, SWITCHING, precision=precision),
    "fixed": lambda _: bundle(TONAL, SLOW, precision="q31", spans=dict.fromkeys(("ax", "ay"), (-SPAN, SPAN))),
}
PAGE = Path(__file__).parents[2] / "docs" / "export.md"


def deviations(kind: str) -> set[str]:
    """Return the rules that the page lists for a kind."""
    (row,) = re.findall(rf"^\| {kind} \| ([\d., ]+) \|$", PAGE.read_text(encoding="utf-8"), re.M)
    return set(row.split(", "))


@pytest.mark.parametrize(
    ("kind", "precision"),
    [(kind, precision) for kind in ("settled", "full") for precision in ("float32", "float64")] + [("fixed", "q31")],
)
def test_misra_reports_what_is_listed(kind: str, precision: Precision, tmp_path: Path) -> None:
    """The files of `native` are the same in both precisions, and looked at in one."""
    need("cppcheck")
    folder = write_bundle(MADE[kind](precision), tmp_path)
    words = ["make", "-C", str(folder), "misra", *(["NATIVE="] if (kind, precision) == ("full", "float64") else [])]
    ran = subprocess.run(words, capture_output=True, text=True, check=False, timeout=300)
    assert ran.returncode == 0, ran.stderr
    by_rule = {rule: int(many) for many, rule in re.findall(r"(\d+) misra-c2012-([\d.]+)", ran.stdout)}
    report = (folder / "misra.txt").read_text()
    assert sum(by_rule.values()) == report.count("[misra-c2012-")
    assert set(by_rule) <= deviations(kind)
    assert "2.5" in by_rule, "the rate of the header is for callers, which cppcheck does not see: is it running?"
