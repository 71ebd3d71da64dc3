"""Tones that the first readings hardly tell from a motion: states far beyond any reading, which float would lose."""

from __future__ import annotations

from pathlib import Path

import pytest

from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import GateRecipe
from becalm.errors import RecipeError
from becalm.export.number_type import FLOAT
from becalm.export.proof.compiling import run
from becalm.export.word_length import start_of
from exported import TONE, built, bundle, channel

SLOW = channel("ax", 2, 0.05, tone=(TONE.model_copy(update={"frequency_hz": 0.5}),))
GATED = channel("ax", 3, 1e-5, gate=GateRecipe(), tone=(TONE.model_copy(update={"frequency_hz": 2.0}),))


@pytest.mark.parametrize("told", [SLOW, GATED], ids=["slow", "gated"])
def test_float_keeps_what_the_first_readings_told(told: ChannelRecipe, tmp_path: Path) -> None:
    made = bundle(told)
    (one,) = made.channels
    assert start_of(one.design, FLOAT) > 1e-4 * one.design.noise_std
    assert one.written.word is None  # its states are in double
    ran = run(built(made, tmp_path))
    assert ran.returncode == 0, ran.stdout


def test_a_table_in_float_is_refused_where_they_would_be_lost() -> None:
    with pytest.raises(
        RecipeError, match="its first readings hardly tell its tones, and float would lose their digits"
    ):
        bundle(SLOW, gain="settled")
    assert bundle(SLOW, gain="settled", precision="float64").channels
