"""How probable modes are, as a stream tells it: the same for any cut, and what a handover makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.streaming.handover import Handover
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Floats
from becalm.core.snapshot_bytes import packed, unpacked
from stream_recipes import CAUSAL, KINDS, LAGGED, RATE_HZ, joined, recipe_of, rough, streamed, wander

ROWS, STEP_S = 700, 1 / RATE_HZ
TWO = KINDS["switching"], KINDS["order 2"], KINDS["jumping"]


def readings(channels: int) -> Floats:
    return np.column_stack([rough(ROWS, seed) for seed in range(channels)])


@pytest.mark.parametrize("how", [CAUSAL, LAGGED], ids=["causal", "lagged"])
def test_probabilities_are_those_of_a_file_and_no_cut_changes_a_bit(how: dict[str, object]) -> None:
    recipe, values, elapsed = recipe_of(*TWO, **how), readings(3), np.ones(ROWS)
    whole = streamed(StreamCleaner(recipe, STEP_S), values, elapsed)
    assert whole.modes.shape == (ROWS, 4)
    cut = streamed(StreamCleaner(recipe, STEP_S), values, elapsed, [1, 2, 40, 41, 500])
    np.testing.assert_array_equal(cut.modes, whole.modes)
    with Cleaner(recipe, STEP_S, split=True) as cleaner:
        answers = cleaner.push(list(values.T), elapsed) + cleaner.finish()
    parts = [np.concatenate([one[c].parts for one in answers], axis=1)[-2:] for c in (0, 2)]
    np.testing.assert_allclose(whole.modes.T, np.concatenate(parts), rtol=0, atol=1e-12)
    told = whole.modes[20:, :2].sum(axis=1)
    np.testing.assert_allclose(told, 1.0, atol=1e-12)
    assert np.ptp(whole.modes[:, 1]) > 0.5, "it switches"


def test_where_nothing_switches_nothing_is_told() -> None:
    told = streamed(StreamCleaner(recipe_of(KINDS["order 2"]), STEP_S), readings(1), np.ones(ROWS))
    assert told.modes.shape == (0, 0)


def test_a_snapshot_of_rows_that_wait_may_know_no_modes() -> None:
    """As one that an older becalm kept."""
    recipe, values = recipe_of(*TWO, **LAGGED), readings(3)
    stream = StreamCleaner(recipe, STEP_S)
    before = stream.push(values[:300], np.ones(300))
    arrays = unpacked(stream.snapshot())
    old = {
        name: array[:0] if name.startswith("ready") and name.endswith("parts") else array
        for name, array in arrays.items()
    }
    resumed = StreamCleaner.resume(packed(old), recipe)
    after = joined([resumed.push(values[300:], np.ones(ROWS - 300)), resumed.finish()])
    assert len(before.modes) + len(after.modes) == ROWS
    assert np.isfinite(after.modes[50:]).all()


@pytest.mark.parametrize(("later", "modes"), [("switching", 2), ("order 2", 0)])
def test_a_handover_tells_the_modes_of_the_filter_that_is_told_more(later: str, modes: int) -> None:
    values, elapsed = wander(ROWS)[:, np.newaxis], np.ones(ROWS)
    handover = Handover(
        StreamCleaner(recipe_of(KINDS["switching"]), STEP_S), StreamCleaner(recipe_of(KINDS[later]), STEP_S), 100
    )
    told = handover.push(values, elapsed)
    assert told.modes.shape == ((ROWS, modes) if modes else (0, 0))


def test_modes_that_only_the_later_recipe_has_are_unknown_until_it_is_told() -> None:
    former, later = (StreamCleaner(recipe_of(KINDS[kind]), STEP_S) for kind in ("order 2", "switching"))
    handover = Handover(former, later, 100)
    told = handover.push(wander(ROWS)[:, np.newaxis], np.ones(ROWS))
    unknown = np.isnan(told.modes[:, 0])
    assert unknown[:149].all()
    assert not unknown[150:].any()
