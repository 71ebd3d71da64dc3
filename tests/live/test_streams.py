"""A stream may be cut and paused anywhere, and no bit changes; what does not fit it is refused in a sentence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.streaming.stream import StreamCleaner, Streamed
from becalm.core.arrays import Floats
from becalm.core.model.components import motion as motion_of
from becalm.core.model.components import oscillator
from becalm.core.model.step_matrices import StepMatrices
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.errors import ModelError, RecipeError
from bits import same_bits
from stream_recipes import (
    CAUSAL,
    KINDS,
    LAGGED,
    RATE_HZ,
    joined,
    motion,
    recipe_of,
    rough,
    streamed,
    uneven,
    wander,
)

ROWS, STEP_S = 420, 1 / RATE_HZ
BOTH: list[dict[str, Any]] = [CAUSAL, LAGGED]
RECIPES = [recipe_of(*KINDS.values(), **how) for how in BOTH]
VALUES = np.column_stack([np.roll(rough(ROWS, seed), 37 * seed) for seed in range(len(KINDS))])
EVEN, UNEVEN = np.ones(ROWS), uneven(ROWS, 7, whole=True)  # whole, as coloured noise is among them
WHOLE = {
    (lagged, even): streamed(StreamCleaner(RECIPES[lagged], STEP_S), VALUES, EVEN if even else UNEVEN)
    for lagged in (False, True)
    for even in (False, True)
}

CUTS = st.one_of(
    st.lists(st.integers(0, ROWS), max_size=12).map(sorted),
    st.tuples(st.integers(0, ROWS - 40), st.integers(0, 40)).map(lambda run: list(range(run[0], run[0] + run[1]))),
    st.just(list(range(1, ROWS))),
)


def assert_same_bits(got: Streamed, expected: Streamed) -> None:
    assert same_bits(got.signal, expected.signal)
    assert same_bits(got.sigma, expected.sigma)
    np.testing.assert_array_equal(got.verdicts, expected.verdicts)


@pytest.mark.parametrize("even", [True, False], ids=["even", "uneven"])
@pytest.mark.parametrize("lagged", [False, True], ids=["causal", "lagged"])
@given(where=CUTS)
@settings(max_examples=6, deadline=None)
def test_any_cuts_give_the_same_bits(lagged: bool, even: bool, where: list[int]) -> None:
    stream = StreamCleaner(RECIPES[lagged], STEP_S)
    assert_same_bits(streamed(stream, VALUES, EVEN if even else UNEVEN, where), WHOLE[lagged, even])


@pytest.mark.parametrize("lagged", [False, True], ids=["causal", "lagged"])
@given(where=CUTS, pauses=st.sets(st.integers(0, 12), min_size=1))
@settings(max_examples=4, deadline=None)
def test_a_paused_stream_forgets_nothing(lagged: bool, where: list[int], pauses: set[int]) -> None:
    recipe = RECIPES[lagged]
    stream, through, told = StreamCleaner(recipe, STEP_S), StreamCleaner(recipe, STEP_S), []
    for number, rows in enumerate(np.split(np.arange(ROWS), where)):
        told.append(stream.push(VALUES[rows], UNEVEN[rows]))
        through.push(VALUES[rows], UNEVEN[rows])
        if number in pauses:
            stream = StreamCleaner.resume(stream.snapshot(), recipe)
        assert stream.snapshot() == through.snapshot()
    assert stream.health() == through.health()
    assert_same_bits(joined([*told, stream.finish()]), WHOLE[lagged, False])


def test_a_snapshot_does_not_depend_on_cuts() -> None:
    """That of a gate with a lag may, in its last digit: it follows the filter from cut to cut."""
    whole, cut = (StreamCleaner(RECIPES[False], STEP_S) for _ in range(2))
    whole.push(VALUES, UNEVEN)
    for row in range(ROWS):
        cut.push(VALUES[row : row + 1], UNEVEN[row : row + 1])
    assert whole.snapshot() == cut.snapshot()
    assert whole.health() == cut.health()


def test_a_snapshot_is_small() -> None:
    recipe = recipe_of(*[motion(3) for _ in range(6)])
    stream = StreamCleaner(recipe, STEP_S)
    stream.push(np.column_stack([wander(5000, seed) for seed in range(6)]), np.ones(5000))
    assert len(stream.snapshot()) < 6 * 2000


def test_finish_changes_nothing() -> None:
    stream = StreamCleaner(RECIPES[True], STEP_S)
    stream.push(VALUES[:200], EVEN[:200])
    before = stream.snapshot()
    assert len(stream.finish().signal) > 0
    assert stream.snapshot() == before


RECIPE = recipe_of(motion(2), motion(1))


def snapshot() -> bytes:
    stream = StreamCleaner(RECIPE, STEP_S)
    stream.push(VALUES[:50, :2], EVEN[:50])
    return stream.snapshot()


@given(at=st.integers(0, len(snapshot()) - 1), flip=st.integers(1, 255))
@settings(max_examples=60, deadline=None)
def test_a_damaged_snapshot_is_refused(at: int, flip: int) -> None:
    blob = bytearray(snapshot())
    blob[at] ^= flip
    with pytest.raises(ModelError, match="damaged"):
        StreamCleaner.resume(bytes(blob), RECIPE)


@pytest.mark.parametrize("blob", [b"", b"x", b"abcd", b"no snapshot", packed({}), packed({"told": np.zeros(1)})])
def test_other_bytes_are_no_snapshot(blob: bytes) -> None:
    with pytest.raises(ModelError, match=r"not a snapshot|version"):
        StreamCleaner.resume(blob, RECIPE)


def test_a_snapshot_of_another_version_is_refused() -> None:
    arrays = unpacked(snapshot())
    arrays["told"][0] += 1
    with pytest.raises(ModelError, match="version 9; this becalm reads 8"):
        StreamCleaner.resume(packed(arrays), RECIPE)


@pytest.mark.parametrize("name", ["channel0.state", "channel0.rhythm", "channel0.begun", "step_s"])
@pytest.mark.parametrize("mistake", ["missing", "misshapen"])
def test_a_snapshot_with_a_part_that_does_not_fit_is_refused(name: str, mistake: str) -> None:
    arrays = unpacked(snapshot())
    part = arrays.pop(name)
    if mistake == "misshapen":
        arrays[name] = np.zeros((3, *part.shape, 2))
    with pytest.raises(ModelError, match="snapshot"):
        StreamCleaner.resume(packed(arrays), RECIPE)


@pytest.mark.parametrize(
    "other",
    [recipe_of(motion(2), motion(2)), recipe_of(motion(2)), recipe_of(motion(2), motion(1), mode="smoothed")],
    ids=["order", "count", "mode"],
)
def test_a_snapshot_of_another_recipe_is_refused(other: Recipe) -> None:
    with pytest.raises(RecipeError, match="another recipe"):
        StreamCleaner.resume(snapshot(), other)


@pytest.mark.parametrize(
    ("values", "elapsed", "says"),
    [
        (np.ones((3, 3)), np.ones(3), "2 channels"),
        (np.ones(3), np.ones(3), r"need \(B, 2\)"),
        (np.ones((3, 2)), np.ones(2), r"elapsed \(2,\)"),
        (np.ones((3, 2)), np.ones((3, 1)), "elapsed"),
        (np.ones((3, 2)), np.array([1.0, -1.0, 1.0]), "time cannot go back"),
        (np.ones((3, 2)), np.array([1.0, 1.0, np.nan]), "time cannot go back"),
        (np.full((3, 2), "a"), np.ones(3), "numbers"),
        (np.ones((3, 2), complex), np.ones(3), "numbers"),
    ],
)
def test_what_does_not_fit_is_refused(values: Any, elapsed: Floats, says: str) -> None:
    stream = StreamCleaner(RECIPE, STEP_S)
    before = stream.snapshot()
    with pytest.raises(ModelError, match=says):
        stream.push(values, elapsed)
    assert stream.snapshot() == before


@pytest.mark.parametrize("kind", [np.float32, np.int64, np.bool_])
def test_other_numbers_are_taken(kind: type) -> None:
    values: Any = np.round(np.nan_to_num(VALUES[:40, :2])).clip(-9, 9).astype(kind)
    got = StreamCleaner(RECIPE, STEP_S).push(np.asfortranarray(values), np.ones(40, int))
    assert_same_bits(got, StreamCleaner(RECIPE, STEP_S).push(values.astype(np.float64), np.ones(40)))


def test_nothing_is_taken_as_nothing() -> None:
    for recipe in (RECIPE, recipe_of(KINDS["untold"], motion(1), **LAGGED)):
        stream = StreamCleaner(recipe, STEP_S)
        before = stream.snapshot()
        nothing = [(0, 2), (0, 2), (0, 2), (0, 0)]  # and no modes
        assert [part.shape for part in stream.push(np.empty((0, 2)), np.empty(0))] == nothing
        assert [part.shape for part in stream.finish()] == nothing
        assert stream.snapshot() == before


def test_readings_are_not_touched() -> None:
    values, elapsed = VALUES.copy(), UNEVEN.copy()
    streamed(StreamCleaner(RECIPES[False], STEP_S), values, elapsed)
    assert same_bits(values, VALUES)
    assert same_bits(elapsed, UNEVEN)


@pytest.mark.parametrize("how", BOTH, ids=["causal", "lagged"])
def test_health_tells_what_became_of_readings(how: dict[str, Any]) -> None:
    recipe = recipe_of(KINDS["limits"], KINDS["untold"], **how)
    stream, rng = StreamCleaner(recipe, STEP_S), np.random.default_rng(0)
    z = np.cumsum(0.03 * rng.normal(size=4000)) + rng.normal(size=4000)
    z[100:120] = np.nan
    told = streamed(stream, np.column_stack([z, z]), np.ones(4000), range(50, 4000, 50))
    moving, unchanged = stream.health()
    assert (moving.name, unchanged.name) == ("c0", "c1")
    assert moving.counts["missing"] == unchanged.counts["missing"] == 20
    assert sum(moving.counts.values()) == 4000 - (stream.lag_rows or 0)
    assert moving.nis is not None
    assert 0.1 < moving.nis < 2.0
    assert unchanged.nis is None
    assert not moving.dead
    assert moving.counts["used"] == np.count_nonzero(told.verdicts[: 4000 - stream.lag_rows, 0] == 0)


@pytest.mark.parametrize("how", BOTH, ids=["causal", "lagged"])
def test_health_tells_of_drift_and_death(how: dict[str, Any]) -> None:
    channel = motion(1, limits=KINDS["limits"].limits)
    rng = np.random.default_rng(0)
    noisy, ramp = rng.normal(size=3000), np.arange(3000) / 3
    quick = channel.model_copy(
        update={"limits": channel.limits and channel.limits.model_copy(update={"high": None, "largest": None})}
    )
    stream = StreamCleaner(recipe_of(channel, quick, **how), STEP_S)
    values = np.column_stack([np.where(np.arange(3000) < 1500, noisy, 1e-4 * noisy), noisy])
    values[1500:, 1] += 2 * ramp[:1500]
    streamed(stream, values, np.ones(3000), range(100, 3000, 100))
    dead, drifting = stream.health()
    assert dead.dead
    assert not drifting.dead
    assert dead.counts["dead"] > 1000
    assert drifting.drift_since_row is not None
    assert 1400 < drifting.drift_since_row < 1600
    assert drifting.counts["drift"] > 0


@given(lengths=st.lists(st.sampled_from([0.0, 0.1, 1.0, 1.5, 1e3]) | st.floats(0, 1e4), min_size=1, unique=True))
@settings(deadline=None)
def test_steps_are_the_same_alone_and_in_company(lengths: list[float]) -> None:
    for component in (motion_of(5), motion_of(3) + oscillator(0.1, 0.01), motion_of(2) + oscillator(0.2)):
        together = StepMatrices(component).over(np.array(lengths, dtype=np.float64))
        alone = [StepMatrices(component).over(np.array([length])) for length in lengths]
        for k, matrices in enumerate(together):
            assert same_bits(matrices, np.concatenate([one[k] for one in alone]))


def test_steps_are_forgotten_when_they_are_too_many() -> None:
    steps, component = StepMatrices(motion_of(2)), motion_of(2)
    for k in range(30):
        lengths = np.linspace(1.0, 1.1, 100) + 0.1 * k
        for got, expected in zip(steps.over(lengths), component.over(lengths), strict=True):
            assert same_bits(got, expected)
