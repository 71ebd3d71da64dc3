"""What a person hands over by mistake is refused with a sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import becalm
from becalm.core.filter.gate import Gate
from becalm.errors import BecalmError

ROWS = becalm.Recording(np.random.default_rng(0).normal(size=200), rate_hz=100.0)
MISTAKES: dict[str, tuple[Callable[..., Any], str]] = {
    "a lag with its unit": (lambda: becalm.clean(ROWS, lag_s="10ms"), "lag_s = '10ms' is not a number; give seconds"),  # type: ignore[arg-type]
    "a recipe's file": (lambda: becalm.clean(ROWS, "a.toml"), "A Recipe is needed; 'a.toml' came. Load one"),  # type: ignore[arg-type]
    "a number for wishes": (lambda: becalm.tune(ROWS, wishes=3), "Wishes are needed; 3 came. Make some"),  # type: ignore[arg-type]
    "a list for a recording": (lambda: becalm.clean([1, 2]), "A Recording is needed; list came"),  # type: ignore[arg-type]
    "a threshold as text": (lambda: Gate("5"), "threshold = '5' is not a threshold"),  # type: ignore[arg-type]
    "half a reject": (lambda: Gate(5.0, 2.5), "agree = 2.5 and at_most = "),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_said(name: str) -> None:
    make, says = MISTAKES[name]
    with pytest.raises(BecalmError, match=f"^{says}"):
        make()


def test_a_table_is_written_of_a_recording(tmp_path: Path) -> None:
    with pytest.raises(BecalmError, match="A Recording is needed; ndarray came: write"):
        becalm.write(tmp_path / "a.csv", np.ones(3))  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
