"""A stream tells what a file tells: signal, sigma and verdicts of every kind of recipe, over whatever befalls rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.pipeline import clean, in_mode
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.streaming.stream import StreamCleaner, Streamed
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from stream_recipes import (
    CAUSAL,
    KINDS,
    LAGGED,
    RATE_HZ,
    assert_same_numbers,
    motion,
    recipe_of,
    rough,
    streamed,
    uneven,
    wander,
)

ROWS = 1700


def of_file(recipe: Recipe, values: Floats, elapsed: Floats, step_s: float = 1 / RATE_HZ) -> Streamed:
    """Clean rows as those of a file are."""
    causal = recipe if recipe.mode == "lagged" else in_mode(recipe, causal=True)
    with Cleaner(causal, step_s) as cleaner:
        columns = [np.ascontiguousarray(column) for column in values.T]
        (told,) = [*cleaner.push(columns, elapsed), *cleaner.finish()]
    fields = [[getattr(channel, name) for channel in told] for name in ("signal", "sigma", "verdicts")]
    return Streamed(*(np.column_stack(field) for field in fields))


RECORDS: dict[str, tuple[Floats, Floats]] = {
    "smooth": (wander(ROWS), np.ones(ROWS)),
    "rough": (rough(ROWS), np.ones(ROWS)),
    "uneven": (wander(ROWS), uneven(ROWS)),
    "rough and uneven": (rough(ROWS, 2), uneven(ROWS, 2)),
    "late to begin": (np.where(np.arange(ROWS) < 700, np.nan, rough(ROWS, 3)), np.ones(ROWS)),
    "nothing": (np.full(ROWS, np.nan), np.ones(ROWS)),
    "far": (1e9 + wander(ROWS), np.ones(ROWS)),
}


@pytest.mark.parametrize("how", [CAUSAL, LAGGED], ids=["causal", "lagged"])
@pytest.mark.parametrize("record", RECORDS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_stream_is_the_file(kind: str, record: str, how: dict[str, Any]) -> None:
    recipe, (z, elapsed) = recipe_of(KINDS[kind], **how), RECORDS[record]
    if KINDS[kind].coloured_noise is not None:
        elapsed = np.round(elapsed)  # coloured noise goes in whole steps
    got = streamed(StreamCleaner(recipe, 1 / RATE_HZ), z[:, np.newaxis], elapsed, range(13, ROWS, 97))
    assert_same_numbers(got, of_file(recipe, z[:, np.newaxis], elapsed))


def test_channels_side_by_side_do_not_mind_each_other() -> None:
    recipe = recipe_of(*KINDS.values(), motion(2), motion(3))
    values = np.column_stack([rough(ROWS, seed) for seed in range(len(recipe.channel))])
    elapsed = uneven(ROWS, 5, whole=True)
    got = streamed(StreamCleaner(recipe, 1 / RATE_HZ), values, elapsed, range(1, ROWS, 61))
    assert_same_numbers(got, of_file(recipe, values, elapsed))


def test_a_smoothing_recipe_runs_causally() -> None:
    recipe = recipe_of(motion(2), mode="smoothed")
    values = wander(ROWS)[:, np.newaxis]
    recording = Recording(values, names=["c0"], rate_hz=RATE_HZ)
    cleaned = clean(recording, recipe, causal=True)
    got = streamed(StreamCleaner(recipe, 1 / RATE_HZ), values, recording.timebase.elapsed_steps)
    told = Streamed(cleaned.signal.samples, cleaned.sigma.samples, cleaned.verdicts["c0"][:, np.newaxis])
    assert_same_numbers(got, told)


def test_lagged_rows_come_when_those_after_them_are_there() -> None:
    stream = StreamCleaner(recipe_of(motion(2), **LAGGED), 1 / RATE_HZ)
    counts = [len(stream.push(np.ones((1, 1)) * k, np.ones(1)).signal) for k in range(30)]
    assert stream.lag_rows == 9
    assert counts == [0] * 9 + [1] * 21
    assert len(stream.finish().signal) == 9
