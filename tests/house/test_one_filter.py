"""Where filters are computed: in the places that the design page lists, each with its reason, and in no other."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "src" / "becalm"
MOST = 8
IN_PYTHON = re.compile(
    r"\b([A-Za-z_][\w.]*) @ [\w.]+ @ \1(?:\.conj\(\))?\.T \+"  # F P F' + Q, and A P A' + K R K'
    r"|[+=(] ?K[\w.]* [@*] \(?(?:nu|z)\b"  # x + K nu
)
IN_C = re.compile(r"\b(?:propagate|joseph|joseph_of|add_equation)\(|\bFP\[")
IN_A_TEMPLATE = re.compile(r"\* nu\b|becalm_times\(nu\b")
NO_FILTER = {"core/model/discretisation.py", "core/steady/steady_filter.py"}
"""The noise of a step is that of its two halves; an error is what noise adds up to: products alike, of no state."""


def computed_in() -> set[str]:
    """Return the files that predict or update."""
    found = {path for path in SOURCES.rglob("*.py") if IN_PYTHON.search(path.read_text(encoding="utf-8"))}
    for files, arithmetic in (("native/*.[ch]", IN_C), ("**/*.c.jinja", IN_A_TEMPLATE)):
        found |= {path for path in SOURCES.glob(files) if arithmetic.search(path.read_text(encoding="utf-8"))}
    return {path.relative_to(SOURCES).as_posix() for path in found} - NO_FILTER


def listed() -> list[set[str]]:
    """Return the files of each place in the table of the design page."""
    page = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    table = page.split("## Where filters are computed", 1)[1].split("\n## ", 1)[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    return [set(re.findall(r"`([^`]+)`", row)) for row in rows]


def test_filters_are_computed_where_the_design_page_says() -> None:
    places = listed()
    assert 1 < len(places) <= MOST
    assert set.union(*places) == computed_in()
    assert sum(map(len, places)) == len(set.union(*places))


def test_a_filter_elsewhere_would_be_found() -> None:
    for line in ("P = F @ P @ F.T + Q", "P = A @ P @ A.T + K @ R @ K.T", "x = x + K @ nu", "x + K * (z - H @ x)"):
        assert IN_PYTHON.search(line), line
    for line in ("propagate(n, F, Q, P);", "joseph(n, h, R, K, Ph, P);"):
        assert IN_C.search(line), line
    assert IN_A_TEMPLATE.search("s->x[i] += gain[i] * nu;")
