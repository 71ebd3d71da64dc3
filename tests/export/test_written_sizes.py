"""What a filter takes of memory is what is said: of its state, and of its tables, for each kind and precision."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe
from becalm.export.bundle import Bundle
from becalm.export.proof.compiling import STRICT
from becalm.export.proof.verifying import write_bundle
from exported import HUM, LIMITS, MODES, SPAN, TONE, bundle, channel, need

GATED = channel("ax", 2, 0.05, gate=GateRecipe())
FLOATING: dict[str, tuple[str, ChannelRecipe, dict[str, Any]]] = {
    "level, exact": ("Settled", channel("ax", 1, 0.2), {}),
    "slope, exact": ("Settled", channel("ax", 2, 0.05), {}),
    "snap, exact": ("Settled", channel("ax", 5, 0.2), {"gain": "settled"}),
    "tone": ("Settled", channel("ax", 2, 0.05, tone=(TONE,)), {}),
    "settled, with limits, exact": ("Settled", channel("ax", 2, 0.05, limits=LIMITS), {}),
    "thinned": ("Settled", channel("ax", 2, 2e-3), {"gain": "settled"}),
    "thinned, with limits": ("Settled", channel("ax", 2, 2e-3, limits=LIMITS), {"gain": "settled"}),
    "full": ("WholeChannel", channel("ax", 2, 0.05), {"gain": "full"}),
    "full, with limits": ("WholeChannel", channel("ax", 3, 0.05, limits=LIMITS), {"gain": "full"}),
    "full, with a disturbance": ("WholeChannel", channel("ax", 1, 0.05, tone=(HUM,)), {"gain": "full"}),
    "gate": ("WholeChannel", GATED, {}),
    "gate and limits": ("WholeChannel", GATED.model_copy(update={"limits": LIMITS}), {}),
    "never settled": ("WholeChannel", channel("ax", 2, 0.0), {}),
    "bank": ("WholeChannel", channel("ax", 2, 0.05, switching=MODES), {}),
    "bank, with limits": ("WholeChannel", channel("ax", 2, 0.05, switching=MODES, limits=LIMITS), {}),
}
COUNTED = {
    name: FLOATING[name][1]
    for name in ("level, exact", "slope, exact", "snap, exact", "tone", "settled, with limits, exact")
} | {
    "thinned": channel("ax", 1, 1e-3),
    "thinned, with limits": channel("ax", 1, 1e-3, limits=LIMITS),
}
BUNDLES = [
    pytest.param(kind, told, {"precision": precision, **asked}, id=f"{precision} {name}")
    for precision in ("float32", "float64")
    for name, (kind, told, asked) in FLOATING.items()
] + [
    pytest.param(
        "FixedPointFilter",
        told,
        {"precision": "q31", "spans": {} if told.limits else {"ax": (-SPAN, SPAN)}},
        id=f"q31 {name}",
    )
    for name, told in COUNTED.items()
]


def sizes(made: Bundle, folder: Path) -> tuple[int, int]:
    """Return the bytes of a state, and of all objects in program memory, by the symbols of a compiler.

    At -O0, where every table keeps its symbol.
    """
    need("cc")
    need("nm")
    place = write_bundle(made, folder)
    (place / "sized.c").write_text('#include "drive.c"\nchar sized[sizeof(drive_ax_state)];\n', encoding="utf-8")
    subprocess.run(["cc", *STRICT, "-O0", "-c", "sized.c"], cwd=place, check=True)
    said = subprocess.run(["nm", "-S", "sized.o"], cwd=place, check=True, capture_output=True, text=True).stdout
    symbols = [line.split()[1:] for line in said.splitlines() if len(line.split()) == 4]
    (state,) = (int(size, 16) for size, _, name in symbols if name == "sized")
    return state, sum(int(size, 16) for size, kind, _ in symbols if kind in "rR")


@pytest.mark.parametrize(("kind", "told", "asked"), BUNDLES)
def test_memory_is_what_is_said(
    kind: str, told: ChannelRecipe, asked: dict[str, Any], request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    made = bundle(told, **asked)
    (one,) = made.channels
    assert type(one.kind).__name__ == kind
    name = request.node.callspec.id
    assert not ("exact" in name and not one.written.exact)
    assert not ("thinned" in name and one.written.exact)
    assert sizes(made, tmp_path) == (one.written.state_bytes, one.written.table_bytes)
