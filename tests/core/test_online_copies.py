"""A copy of a filter goes on by itself, with the bits of one that was never copied."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest

from banks import bank_of
from becalm.core.arrays import Floats
from becalm.core.filter.gate import Gate
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import motion, oscillator
from becalm.core.model.model import Model
from becalm.core.online import Online
from becalm.errors import ModelError

SLOPE = Model([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]], np.diag([1e-4, 1e-5]), [[0.25]])
TWO = Model(SLOPE.F, np.eye(2), SLOPE.Q, np.eye(2))
KINDS: dict[str, Callable[[], Online]] = {
    "one channel": lambda: Online(SLOPE),
    "lagged": lambda: Online(SLOPE, lag=5),
    "gated": lambda: Online(SLOPE, gate=Gate(4.0, 3, 6)),
    "two channels": lambda: Online(TWO),
    "modes": lambda: Online(bank_of(2, 3)),
    "lagged modes": lambda: Online(bank_of(2, 3), lag=5),
}
WAYS: dict[str, Callable[[Online], Online]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda online: pickle.loads(pickle.dumps(online)),
}


def stepped(online: Online, rows: Floats) -> Floats:
    return np.array([online.step(float(row[0]) if online.model.channels == 1 else row) for row in rows])


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_copy_goes_on_and_moves_nothing_else(kind: str, way: str) -> None:
    first, own = KINDS[kind](), KINDS[kind]()
    rows = np.random.default_rng(7).normal(size=(60, first.model.channels))
    stepped(first, rows[:20])
    stepped(own, rows[:20])
    other = WAYS[way](first)
    wanted = stepped(own, rows[20:])
    np.testing.assert_array_equal(stepped(other, rows[20:]), wanted)
    np.testing.assert_array_equal(stepped(first, rows[20:]), wanted)


def test_modes_go_on_from_a_snapshot_whatever_was_measured() -> None:
    """A measurement of 1e12 sigma leaves a variance without digits, perhaps below 0."""
    moving = Mode("moving", motion(1, 0.01) + oscillator(0.05, 1e-3, 1e-3), 1.0, 50.0)
    switching = InteractingModels((Mode("still", motion(1, 1e-6), 1.0, 20.0), moving))
    for seed in range(8):
        rng, online = np.random.default_rng(seed), Online(switching)
        z = rng.normal(size=(120, 1))
        z[rng.random(120) < 0.1] = np.nan
        z[rng.integers(0, 120, 3), 0] = rng.choice([1e300, 1e12, 1e16], 3)
        wanted = stepped(Online(switching), z)
        for k in range(len(z)):
            stepped(online, z[k : k + 1])
            again = Online.resume(online.snapshot())
            if k % 20 == 0:
                np.testing.assert_array_equal(stepped(again, z[k + 1 :]), wanted[k + 1 :])


def test_a_number_beyond_float64_is_refused_in_a_sentence() -> None:
    for ask in (Online(SLOPE).step, lambda z: Online(SLOPE).run([z])):
        with pytest.raises(ModelError, match="not an array of numbers"):
            ask(10**400)
