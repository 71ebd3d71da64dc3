"""The door to several modes in C: arrays that do not fit, states that cannot be, records that are cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from banks import bank_of, laid_out, new_trace, record
from becalm.native.imm import (
    BLOCK,
    NO_BUFFERS,
    ImmBuffers,
    blocks_before,
    filter_rows,
    new_state,
    nothing_later,
    restored,
    smooth_late,
    smooth_rows,
)
from bits import same_bits

SWITCHING = bank_of(2, 3, share=0.05, rejects=True)
ROWS = 2 * BLOCK + 50
Z, ELAPSED = record(ROWS, "holes")
BANK, STEPS = laid_out(SWITCHING, ELAPSED)


def test_arrays_that_do_not_fit_are_refused() -> None:
    state, before = new_state(BANK, keeps_level=False), blocks_before(BANK, ROWS)
    short = NO_BUFFERS._replace(signal=np.empty(ROWS - 1), sigma=np.empty(ROWS - 1))
    alone = NO_BUFFERS._replace(signal=np.empty(ROWS))
    for refused in (
        lambda: filter_rows(BANK, state, Z[::2], STEPS),
        lambda: filter_rows(BANK, state, Z, STEPS.astype(np.int64)),
        lambda: filter_rows(BANK, state, Z, STEPS + 1),
        lambda: filter_rows(BANK, state, Z, STEPS - 1),
        lambda: filter_rows(BANK, state, Z, STEPS, short),
        lambda: filter_rows(BANK, state, Z, STEPS, alone),
        lambda: filter_rows(BANK, state, Z, STEPS, before=before[1:]),
        lambda: filter_rows(BANK, state, Z, STEPS, notes=before),
        lambda: filter_rows(BANK._replace(F=BANK.F[1:]), state, Z, STEPS),
        lambda: filter_rows(bank_of(1, 3).matrices(np.ones(1)), state, Z, STEPS),
        lambda: smooth_rows(BANK, state, Z, STEPS, before, np.zeros(3), NO_BUFFERS),
        lambda: smooth_late(BANK, state, STEPS, before, NO_BUFFERS, turn=1, every=1, lag=1),
        lambda: smooth_late(BANK, state, STEPS, before, NO_BUFFERS, turn=1, every=0, lag=1),
    ):
        with pytest.raises(ValueError, match=r"shape|steps go|written together|not one of|1 or more"):
            refused()


def test_states_that_cannot_be_are_refused() -> None:
    state = new_state(BANK, keeps_level=True)
    filter_rows(BANK, state, Z, STEPS)

    def kept(**changed: float) -> np.ndarray[tuple[int], np.dtype[np.int8]]:
        spoilt = state.copy()
        for name, value in changed.items():
            spoilt[name] = value
        return np.frombuffer(spoilt.tobytes(), np.int8)

    whole = restored(BANK, kept())
    assert whole is not None
    assert whole.tobytes() == state.tobytes()
    for name, value in (
        ("layout", 99), ("states", 1), ("modes", 2), ("has_level", 2), ("level", np.nan), ("level", np.inf),
        ("mu", 0.0), ("mu", 3.0), ("mu", np.nan), ("x", np.inf), ("P", np.nan), ("P", np.inf),
    ):  # fmt: skip
        spoilt = restored(BANK, kept(**{name: value}))
        assert spoilt is None or (name, value) == ("mu", 0.0), name  # nothing was read yet
    assert restored(BANK, kept()[1:]) is None


@given(at=st.lists(st.integers(0, ROWS), max_size=5).map(sorted))
@settings(max_examples=30)
def test_any_cut_gives_the_same_bits(at: list[int]) -> None:
    whole, state, parts = new_trace(SWITCHING, ROWS), new_state(BANK, keeps_level=True), list[ImmBuffers]()
    filter_rows(BANK, new_state(BANK, keeps_level=True), Z, STEPS, whole)
    for z, steps in zip(np.split(Z, at), np.split(STEPS, at), strict=True):
        parts.append(new_trace(SWITCHING, len(z)))
        filter_rows(BANK, state, z, steps, parts[-1])
    for name in ImmBuffers._fields:
        joined = np.concatenate([getattr(part, name) for part in parts], axis=-1)
        assert same_bits(joined, getattr(whole, name)), name


def test_a_record_is_smoothed_in_parts_as_in_one() -> None:
    state, before = new_state(BANK, keeps_level=False), blocks_before(BANK, ROWS)
    filter_rows(BANK, state, Z, STEPS, before=before)
    whole, later = new_trace(SWITCHING, ROWS), nothing_later(BANK)
    smooth_rows(BANK, state, Z, STEPS, before, nothing_later(BANK), whole)
    for rows, blocks in ((slice(BLOCK, None), before[1:]), (slice(BLOCK), before[:1])):
        some = new_trace(SWITCHING, len(Z[rows]))
        smooth_rows(BANK, state, Z[rows], STEPS[rows], blocks, later, some)
        for name in ("signal", "sigma", "probability", "mean"):
            assert same_bits(getattr(some, name), getattr(whole, name)[..., rows]), name
