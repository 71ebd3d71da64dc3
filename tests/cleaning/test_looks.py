"""Who looks at innovations is given one a row, at its row: of every filter, however the record is cut."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.pipeline import in_mode
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording

ROWS, STEP_S, WILD = 4000, 0.01, 3210
RNG = np.random.default_rng(1)
READINGS = np.cumsum(RNG.normal(0, 0.05, ROWS)) + RNG.normal(0, 0.3, ROWS)
MODES = ["causal", "smoothed", "lagged"]


def recipe_of(mode: str, *, robust: bool, gated: bool) -> Recipe:
    found = tune(Recording(READINGS, rate_hz=1 / STEP_S), causal=mode == "causal", wishes=Wishes(robust=robust))
    (channel,) = found.channel
    if not gated:
        channel = channel.model_copy(update={"gate": None})
    found = found.model_copy(update={"channel": (channel,)})
    return in_mode(found, None, 0.1) if mode == "lagged" else found


@pytest.fixture(scope="module")
def recipes() -> dict[str, Recipe]:
    found = {
        f"{mode} {kind}": recipe_of(mode, robust=kind == "switching", gated=kind == "gated")
        for mode in MODES
        for kind in ("gated", "plain", "switching")
    }
    assert all((recipe.channel[0].switching is not None) == ("switching" in name) for name, recipe in found.items())
    assert all((recipe.channel[0].gate is not None) == ("gated" in name) for name, recipe in found.items())
    return found


def looked_at(recipe: Recipe, z: Floats, elapsed: Floats, cut: int) -> Floats:
    """Return the normalised innovations that a look is given."""
    seen: list[Floats] = []
    collect = [lambda innovations, sigma: seen.append(innovations / sigma)]
    with Cleaner(recipe, STEP_S, innovation_callbacks=collect) as cleaner:
        for start in range(0, len(z), cut):
            cleaner.push([z[start : start + cut]], elapsed[start : start + cut])
        cleaner.finish()
    return np.concatenate(seen)


@pytest.mark.parametrize("cut", [ROWS, 777, 256])
@pytest.mark.parametrize("kind", ["gated", "plain", "switching"])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("gap", [1.0, 50.0, 1e13], ids=["even", "gap", "beyond reach"])
def test_one_a_row_at_its_row(gap: float, mode: str, kind: str, cut: int, recipes: dict[str, Recipe]) -> None:
    z, elapsed = READINGS.copy(), np.ones(ROWS)
    z[1000:1300] = z[2000:2500:7] = np.nan
    z[WILD] += 8.0
    elapsed[0], elapsed[2700] = 0.0, gap
    found = looked_at(recipes[f"{mode} {kind}"], z, elapsed, cut)
    assert len(found) == ROWS
    assert np.isnan(found[np.isnan(z)]).all()
    unseen = np.flatnonzero(np.isnan(found) & np.isfinite(z))
    if kind == "plain":
        assert int(np.nanargmax(np.abs(found))) == WILD
    if kind == "gated":
        assert WILD in unseen
    anew = np.isin(unseen, [*range(4), *range(2700, 2704), WILD])
    assert anew.all(), "only what starts, and what is rejected, has none"
