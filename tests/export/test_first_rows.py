"""Tones that the first readings hardly tell from a motion: states far beyond any reading, which float would lose."""

from __future__ import annotations

from decimal import Decimal, localcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe, ToneRecipe
from becalm.core.arrays import Floats
from becalm.core.model.prior import flat_prior
from becalm.errors import RecipeError
from becalm.export.design import Design
from becalm.export.number_type import FLOAT
from becalm.export.proof.compiling import run
from becalm.export.proof.verifying import compare, simulate_readings
from becalm.export.word_length import start_error
from exported import TONE, built, bundle, channel, live

SLOW = channel("ax", 2, 0.05, tone=(TONE.model_copy(update={"frequency_hz": 0.5}),))
GATED = channel("ax", 3, 1e-5, gate=GateRecipe(), tone=(TONE.model_copy(update={"frequency_hz": 2.0}),))


@pytest.mark.parametrize("told", [SLOW, GATED], ids=["slow", "gated"])
def test_float_keeps_what_the_first_readings_told(told: ChannelRecipe, tmp_path: Path) -> None:
    made = bundle(told)
    (one,) = made.channels
    assert start_error(one.design, FLOAT) > 1e-4 * one.design.noise_std
    assert one.written.word is None  # its states are in double
    ran = run(built(made, tmp_path))
    assert ran.returncode == 0, ran.stdout


def test_a_table_in_float_is_refused_where_they_would_be_lost() -> None:
    with pytest.raises(RecipeError, match="first readings hardly determine its state, and float would lose the digits"):
        bundle(SLOW, gain="settled")
    assert bundle(SLOW, gain="settled", precision="float64").channels


MANY = channel("ax", 2, 0.05, tone=tuple(TONE.model_copy(update={"frequency_hz": hz}) for hz in (5, 8, 13, 21, 34)))
_exactly = np.vectorize(lambda value: Decimal(float(value)), otypes=[object])


def solved(A: Any, B: Any) -> Any:
    """Return A^-1 B by Gauss and Jordan, in whatever arithmetic they have."""
    A, B = A.copy(), B.copy()
    for i in range(len(A)):
        best = max(range(i, len(A)), key=lambda row: abs(A[row, i]))
        A[[i, best]], B[[i, best]] = A[[best, i]], B[[best, i]]
        A[i], B[i] = A[i] / A[i, i], B[i] / A[i, i]
        for row in set(range(len(A))) - {i}:
            A[row], B[row] = A[row] - A[row, i] * A[i], B[row] - A[row, i] * B[i]
    return B


def first_signal(design: Design, z: Floats) -> Decimal:
    """Return what readings (o,) tell of the signal at the last of them, from information alone, to seventy digits."""
    with localcontext() as context:
        context.prec = 70
        model, n = design.model, design.states
        F, Q, H, one = (_exactly(part) for part in (model.F, model.process_covariance, model.H, np.eye(n)))
        back, R, level = solved(F, one), Decimal(design.noise_variance), Decimal(float(z[0]))
        Y, y = _exactly(flat_prior(model).Y), _exactly(np.zeros((n, 1)))
        for k, reading in enumerate(z.tolist()):
            if k:
                M = back.T.dot(Y).dot(back)
                ahead = solved(one + M.dot(Q), np.hstack([M, back.T.dot(y)]))
                Y, y = ahead[:, :n], ahead[:, n:]
            Y, y = Y + H.T.dot(H) / R, y + H.T * (Decimal(reading) - level) / R
        return Decimal(level + _exactly(design.output).dot(solved(Y, y))[0])


def test_of_a_stream_that_rounds_first_rows_c_keeps_the_same_digits(tmp_path: Path) -> None:
    """A tone of 0.7 Hz beside a level, seen at 250 Hz: nine digits of the first rows are told by the readings."""
    tones = tuple(ToneRecipe(frequency_hz=hz, bandwidth_hz=2e-3, process_noise_density=1e-3) for hz in (17.0, 0.7))
    told = channel("ax", 1, 1e-4, tone=tones, gate=GateRecipe(), rate_hz=250.0)
    made = bundle(told, rate_hz=250.0, precision="float64")
    (one,) = made.channels
    stream = compare(built(made, tmp_path), one, told, "drawn from its model", simulate_readings(one, 50_000))
    assert (stream.beside, stream.kept, stream.error) == ("becalm's stream", True, 0.0)


def test_the_first_signal_is_right_to_what_its_readings_tell() -> None:
    """Two dozen readings hardly tell five tones: becalm, and the weights that C is given, keep eleven digits."""
    (one,) = bundle(MANY, precision="float64").channels
    o = len(one.design.opening.weights)
    z = 40 + np.random.default_rng(1).normal(size=o)
    exact, level = first_signal(one.design, z), z[0]
    told = level + float(one.design.output @ (one.design.opening.weights.T @ (z - level)))
    off = [abs(float(Decimal(float(signal)) - exact)) / 40 for signal in (told, live(one, MANY, z)[-1])]
    assert max(off) <= 1e-11
    assert np.linalg.cond(one.design.opening.P) > 1e6
