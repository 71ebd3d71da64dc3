"""Calm and violent motion: one shock costs a record nothing elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

import becalm
from becalm.cleaning.pipeline import Cleaned
from becalm.core.arrays import Floats
from becalm.identification.likelihood import Evidence, tune_motion
from becalm.identification.modes.banks import pieces_of
from becalm.identification.modes.bursts import find_bursting
from becalm.identification.modes.switching import find_switching

ROWS, RATE_HZ, NOISE = 6000, 200.0, 0.05
SHOCK = slice(3000, 3020)
NEAR = slice(SHOCK.start - 40, SHOCK.stop + 40)


def slow(seed: int) -> Floats:
    """Return a slow motion, of about 1."""
    t, phase = np.arange(ROWS) / RATE_HZ, np.random.default_rng(seed).uniform(0, 2 * np.pi, 2)
    return np.asarray(np.sin(0.5 * t + phase[0]) + 0.2 * np.sin(2.1 * t + phase[1]))


def shocked(signal: Floats, sigmas: float) -> Floats:
    """Return it with half a sine on top."""
    signal = signal.copy()
    signal[SHOCK] += sigmas * NOISE * np.sin(np.pi * (np.arange(20) + 0.5) / 20)
    return signal


def cleaned(z: Floats, causal: bool) -> tuple[Floats, Cleaned]:
    found = becalm.clean(becalm.Recording(z[:, np.newaxis], rate_hz=RATE_HZ), causal=causal)
    return found.signal.samples[:, 0], found


def rms_away(error: Floats) -> float:
    away = np.ones(ROWS, dtype=bool)
    away[NEAR], away[:200] = False, False
    return float(np.sqrt(np.mean(error[away] ** 2)))


@pytest.mark.parametrize(("seed", "causal"), [(0, False), (1, False), (2, True)])
def test_a_shock_changes_nothing_elsewhere(seed: int, causal: bool) -> None:
    noise, signal = NOISE * np.random.default_rng(seed + 30).normal(size=ROWS), slow(seed)
    calm, _ = cleaned(signal + noise, causal)
    truth = shocked(signal, 400.0)
    told, found = cleaned(truth + noise, causal)
    switching = found.recipe.channel[0].switching
    assert switching is not None
    assert switching.kind == "bursting"
    assert rms_away(told - truth) < 1.5 * rms_away(calm - signal)
    assert np.abs(told - truth)[NEAR].max() < (0.05 if causal else 0.01) * 400 * NOISE


@pytest.mark.parametrize("causal", [False, True])
def test_a_shock_among_heavy_tails_changes_nothing_elsewhere(causal: bool) -> None:
    rng, signal = np.random.default_rng(6), slow(6)
    noise = NOISE * rng.standard_t(3, ROWS) / np.sqrt(3)
    calm, _ = cleaned(signal + noise, causal)
    truth = shocked(signal, 400.0)
    told, found = cleaned(truth + noise, causal)
    switching = found.recipe.channel[0].switching
    assert switching is not None
    assert (switching.kind, switching.rejects) == ("bursting", True)
    assert switching.mode[0].wild_share > 1e-3
    assert rms_away(told - truth) < 1.5 * rms_away(calm - signal)


def test_only_the_process_noise_of_a_burst_is_another() -> None:
    z = shocked(slow(1), 200.0) + NOISE * np.random.default_rng(2).normal(size=ROWS)
    evidence = Evidence.of(z, np.ones(ROWS))
    found, believing = find_bursting(tune_motion(2, evidence), evidence, pieces_of(evidence, SHOCK.start), causal=True)
    calm, burst = found.switching.modes
    assert calm.noise_variance == burst.noise_variance == pytest.approx(NOISE**2, rel=0.06)
    assert (calm.component.drift == burst.component.drift).all()
    assert burst.component.noise_density[0, 0] > 1000 * calm.component.noise_density[0, 0]
    assert found.tuning.noise_variance == pytest.approx(calm.noise_variance, rel=1e-12)
    assert (found.switching.rejects, believing.switching.rejects) == (True, False)
    assert believing.log_likelihood == pytest.approx(found.log_likelihood, abs=1.0)


def test_gross_outliers_do_not_take_the_calm_from_a_causal_bank() -> None:
    rng, z = np.random.default_rng(7), shocked(slow(7), 200.0)
    z += NOISE * rng.normal(size=ROWS)
    wild = rng.random(ROWS) < 0.01
    every, elapsed = np.where(wild, z + 2.0 ** rng.integers(4, 12, ROWS), z), np.ones(ROWS)
    evidence = Evidence.of(np.where(wild, np.nan, z), elapsed)
    found = find_switching(tune_motion(2, evidence), evidence, causal=True, wild=Evidence.of(every, elapsed))
    assert found is not None
    assert (found.kind, found.switching.rejects) == ("bursting", False), "else the shock's first reading were wild"


@pytest.mark.parametrize("causal", [False, True])
def test_what_never_is_violent_keeps_its_fixed_filter(causal: bool) -> None:
    z = slow(4) + NOISE * np.random.default_rng(5).normal(size=ROWS)
    _, found = cleaned(z, causal)
    assert found.recipe.channel[0].switching is None
