"""A bank that switches, asked by other roads: the fixed filter, all sequences of modes, truth that was drawn."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from banks import bank_of, kernels, laid_out, record, tones
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import run_filter
from becalm.core.filter.smoothing import run_smoother
from becalm.core.imm import modes
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.metrics.truth import coverage, rms_error
from becalm.native.imm import ImmBuffers, ModeMatrices


def alike(switching: InteractingModels) -> InteractingModels:
    """Return a bank of two modes like the richest."""
    one = switching.modes[-1]
    return InteractingModels((one, Mode("the same", one.component, one.noise_variance, 7.0)))


RICH = {f"order {order}": alike(bank_of(order, 2)) for order in range(1, 6)} | {"two tones": alike(tones(2))}


@pytest.mark.parametrize("kind", ["even", "holes", "uneven"])
@pytest.mark.parametrize("name", RICH)
def test_modes_that_are_alike_are_the_fixed_filter(name: str, kind: str) -> None:
    z, elapsed = record(400, kind)
    one, start = RICH[name].modes[0], RICH[name].start[0, 1:]
    begin = int(np.isfinite(z).argmax())
    own = one.component.to_model(1.0, one.noise_variance)
    x0 = np.zeros(own.states)
    x0[0] = z[begin]
    told = Model(own.F, own.H, own.Q, own.R, own.G, x0, np.diag(start))  # believed after the first reading
    rest = z[begin:].copy()
    rest[0] = np.nan
    line = elapsed_timeline(one.component, one.noise_variance, elapsed[begin:])
    forward, back, _ = kernels(RICH[name], z, elapsed)
    expected = run_filter(told, line, rest[:, np.newaxis]).estimate, run_smoother(told, line, rest[:, np.newaxis])
    for got, wanted in zip((forward, back), expected, strict=True):
        size = np.abs(wanted.signal).max()
        np.testing.assert_allclose(got.signal[begin + 20 :], wanted.signal[20:, 0], rtol=0, atol=1e-9 * size)
        within = 2e-9 if name == "order 5" else 1e-9  # by long double the fixed smoother is off by 1.3e-9, not the bank
        np.testing.assert_allclose(got.sigma[begin + 20 :], wanted.sigma[20:, 0], rtol=within)
        np.testing.assert_allclose(got.probability.sum(axis=0)[begin:], 1.0, rtol=1e-12)


class Exact(NamedTuple):
    """What all sequences of modes together say of each row."""

    signal: Floats  # (N,)
    sigma: Floats  # (N,)
    probability: Floats  # (M, N)


def one_sequence(bank: ModeMatrices, start: Floats, z: Floats, modes: tuple[int, ...]) -> tuple[float, Floats, Floats]:
    """Return log-probability, with all readings, and smoothed mean and covariance of all levels, as one Gaussian."""
    rows, n = len(z), bank.H.shape[1]
    mean, cov = np.zeros((rows, n)), np.zeros((rows, n, rows, n))
    mean[0, 0], cov[0, :, 0, :] = z[0], np.diag(start[modes[0], 1:])
    fit = np.log(start[modes[0], 0])
    for k in range(1, rows):
        F, Q = bank.F[modes[k]], bank.Q[modes[k]]
        fit += np.log(bank.T[0][modes[k - 1], modes[k]])
        mean[k] = F @ mean[k - 1]
        cov[k, :, :k, :] = np.einsum("ab,bkc->akc", F, cov[k - 1, :, :k, :])
        cov[:k, :, k, :] = np.moveaxis(cov[k, :, :k, :], 0, -1)
        cov[k, :, k, :] = F @ cov[k - 1, :, k - 1, :] @ F.T + Q
    level, spread = mean @ bank.H[0], np.einsum("a,jakb,b->jk", bank.H[0], cov, bank.H[0])
    S = spread[1:, 1:] + np.diag(bank.R[list(modes[1:])])
    nu = z[1:] - level[1:]
    K = np.linalg.solve(S, spread[1:]).T
    fit -= 0.5 * (np.linalg.slogdet(2 * np.pi * S)[1] + nu @ np.linalg.solve(S, nu))
    return float(fit), level + K @ nu, np.diag(spread - K @ spread[1:])


def enumerated(bank: ModeMatrices, start: Floats, z: Floats) -> Exact:
    """Smooth by all M^N sequences of modes."""
    sequences = np.array(list(product(range(len(bank.R)), repeat=len(z))))
    fits, levels, variances = zip(
        *(one_sequence(bank, start, z, tuple(own)) for own in sequences.tolist()), strict=True
    )
    weight = np.exp(np.array(fits) - max(fits))
    weight /= weight.sum()
    signal = weight @ np.array(levels)
    sigma = np.sqrt(weight @ (np.array(variances) + (np.array(levels) - signal) ** 2))
    probability = np.array([weight @ (sequences == j) for j in range(len(bank.R))])
    return Exact(signal, sigma, probability)


def filtered_exactly(bank: ModeMatrices, start: Floats, z: Floats) -> Exact:
    """Return the last row of each record that ends earlier."""
    ends = [enumerated(bank, start, z[: k + 1]) for k in range(len(z))]
    return Exact(*(np.array([getattr(end, name)[..., -1] for end in ends]).T for name in Exact._fields))


SHORT = {
    "levels": InteractingModels((Mode("still", motion(1, 1e-4), 1.0, 20.0), Mode("moving", motion(1, 4.0), 1.0, 5.0))),
    "slopes": InteractingModels((Mode("still", motion(1, 1e-4), 1.0, 20.0), Mode("moving", motion(2, 0.3), 1.0, 10.0))),
    "noise": InteractingModels((Mode("quiet", motion(1, 0.1), 1.0, 20.0), Mode("loud", motion(1, 0.1), 25.0, 5.0))),
}


NEAR = {  # mean distance of signal, in sigma of all sequences, of log sigma and of probability: filtered, smoothed
    "levels": ((0.02, 0.02, 0.01), (0.1, 0.1, 0.01)),
    "slopes": ((0.02, 0.02, 0.01), (0.05, 0.06, 0.01)),
    "noise": ((0.15, 0.1, 0.02), (0.15, 0.05, 0.01)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORT)
def test_the_bank_is_near_all_sequences_of_modes(name: str) -> None:
    """It approximates; over records of 10 rows that it draws itself, filtered of 6 rows, it is this near."""
    switching, off = SHORT[name], []
    bank, _ = laid_out(switching, np.ones(10))
    for seed in range(8):
        _, z = drawn(switching, 10, seed)
        forward, back, _ = kernels(switching, z, np.ones(10))
        all_of_them = filtered_exactly(bank, switching.start, z[:6]), enumerated(bank, switching.start, z)
        off.append([apart(got, exact) for got, exact in zip((forward, back), all_of_them, strict=True)])
    assert (np.mean(off, axis=0) < NEAR[name]).all(), np.mean(off, axis=0)


def apart(got: ImmBuffers, exact: Exact) -> list[float]:
    """Return how far they are apart, as `NEAR` counts it."""
    rows = slice(len(exact.signal))
    signal = np.abs(got.signal[rows] - exact.signal) / exact.sigma
    sigma = np.abs(np.log(got.sigma[rows] / exact.sigma))
    probability = np.abs(got.probability[0, rows] - exact.probability[0])
    return [float(np.mean(one)) for one in (signal, sigma, probability)]


@pytest.mark.parametrize("name", ["levels", "slopes"])
def test_two_rows_are_exact(name: str) -> None:
    """Modes that begin alike have nothing to mix before the first switch; the smoother has nothing to pool."""
    z = np.array([0.0, 3.0])
    forward, back, _ = kernels(SHORT[name], z, np.ones(2))
    bank, _ = laid_out(SHORT[name], np.ones(2))
    both = enumerated(bank, SHORT[name].start, z)
    last = filtered_exactly(bank, SHORT[name].start, z)
    for got, exact in ((forward, last), (back, both)):
        np.testing.assert_allclose(got.signal, exact.signal, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(got.sigma, exact.sigma, rtol=1e-12)
        np.testing.assert_allclose(got.probability, exact.probability, rtol=1e-12)


WALKS = InteractingModels(
    tuple(
        Mode(name, motion(1, q), 1.0, lasts, then)
        for name, q, lasts, then in (
            ("still", 1e-10, 3e5, ""),
            ("gentle", 1e-3, 3e5, ""),
            ("quick", 1e-1, 3e5, ""),
            ("abrupt", 1e2, 1.4, "quick"),
        )
    )
)


def smoothed(switching: InteractingModels, z: Floats, *, causal: bool = False) -> tuple[Floats, Floats]:
    made = ImmFlow(switching, causal=causal)
    told = made.push(z, np.ones(len(z))) + made.finish()
    signal, sigma = (np.concatenate([part[field] for part in told]) for field in (0, 1))
    return signal, sigma


def test_a_jump_that_only_later_readings_reveal_is_found() -> None:
    """A step of 0.4 sigma among 4000 rows: the noise of one reading hides it, that of hundreds does not."""
    truth = np.repeat([0.0, 0.4], 2000)
    errors = []
    for seed in range(5):
        z = truth + np.random.default_rng(seed).normal(size=4000)
        signal, _ = smoothed(WALKS, z)
        errors.append([rms_error(signal, truth), rms_error(smoothed(WALKS, z, causal=True)[0], truth)])
        assert np.abs(signal[:1800]).max() < 0.2
        assert np.abs(signal[2200:] - 0.4).max() < 0.2
    back, forward = np.mean(errors, axis=0)
    assert back < 0.07
    assert back < 0.7 * forward


def drawn(switching: InteractingModels, rows: int, seed: int) -> tuple[Floats, Floats]:
    """Draw the signal and its readings from a bank itself."""
    rng, (bank, _) = np.random.default_rng(seed), laid_out(switching, np.ones(rows))
    chosen, n, x = 0, switching.states, np.zeros(switching.states)
    truth, z = np.empty(rows), np.empty(rows)
    roots = np.linalg.cholesky(bank.Q)
    for k in range(rows):
        if k:
            chosen = int(rng.choice(len(bank.R), p=bank.T[0, chosen] / bank.T[0, chosen].sum()))
            x = bank.F[chosen] @ x + roots[chosen] @ rng.normal(size=n)
        truth[k] = x[0]
        z[k] = x[0] + np.sqrt(bank.R[chosen]) * rng.normal()
    return truth, z


DRAWN = ((1e-4, 1.0, 100.0), (1e-1, 1.0, 50.0), (1e-3, 9.0, 60.0), (10.0, 1.0, 10.0))


def honesty(order: int, causal: bool) -> tuple[float, float]:
    """Return how often the truth lies within a sigma, and its mean square distance in sigma."""
    names = ("calm", "moving", "loud", "quick")
    switching = InteractingModels(
        tuple(Mode(name, motion(order, q), r, lasts) for name, (q, r, lasts) in zip(names, DRAWN, strict=True))
    )
    shares, squares = [], []
    for seed in range(20):
        truth, z = drawn(switching, 4000, seed)
        signal, sigma = smoothed(switching, z, causal=causal)
        shares.append(coverage(signal[50:], sigma[50:], truth[50:]))
        squares.append(np.mean((signal[50:] - truth[50:]) ** 2 / sigma[50:] ** 2))
    return float(np.mean(shares)), float(np.mean(squares))


@pytest.mark.parametrize("causal", [True, False])
def test_sigma_covers_what_the_bank_itself_draws(causal: bool) -> None:
    share, square = honesty(2, causal)
    assert 0.65 < share < 0.72
    assert 0.85 < square < 1.15


@pytest.mark.parametrize("causal", [True, False])
def test_sigma_is_honest_where_the_posterior_is_no_gaussian(causal: bool) -> None:
    """Walks so different that a narrow and a wide one remain possible: more lies within one sigma, far less beyond."""
    share, square = honesty(1, causal)
    assert 0.68 < share < 0.8
    assert 0.85 < square < 1.2


def test_matrices_of_many_step_lengths_are_not_kept_for_other_filters() -> None:
    """A record in uneven time has a step length for every row; its matrices would fill the memory."""
    bank = bank_of(2, 2)
    bank.matrices(np.ones(1))
    kept = modes._over.cache_info().currsize
    lengths = np.linspace(1.0, 2.0, 1000)
    np.testing.assert_array_equal(bank.matrices(lengths).F[:2], bank.matrices(np.ones(1)).F)
    assert modes._over.cache_info().currsize == kept
