"""Scores of readings by what several modes expect: standard normal where the bank is right."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from scipy.special import ndtri

from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.kernel_switching_score import normal_score
from becalm.core.switching import Mode, Switching
from becalm.core.switching_flow import SwitchingFlow


def test_a_normal_score_is_the_normal_quantile() -> None:
    score = njit(lambda below, above: normal_score(below, above))
    for tail in [*np.logspace(-299, -1, 50), 0.3, 0.5]:
        assert score(tail, 1 - tail) == pytest.approx(ndtri(tail), rel=1e-12, abs=1e-12)
        assert score(1 - tail, tail) == pytest.approx(-ndtri(tail), rel=1e-12, abs=1e-12)


def test_scores_are_standard_normal_though_levels_jump_and_readings_are_wild() -> None:
    rng, shown, rows = np.random.default_rng(3), list[Floats](), 20_000
    still = Mode("still", motion(1, 1e-9), 1.0, 100.0, wild_share=0.02)
    jump = Mode("jump", motion(1, 3600.0), 1.0, 0.7, "still", 0.02)
    bank = Switching((still, jump), 4e4, rejects=True)
    to_jump, mode = bank.transitions(np.ones(1))[0, :, 1], np.zeros(rows, int)
    for k in range(1, rows):
        mode[k] = rng.random() < to_jump[mode[k - 1]]
    wild = rng.random(rows) < 0.02
    z = np.cumsum(60 * mode * rng.normal(size=rows)) + rng.normal(size=rows) + 200 * wild * rng.normal(size=rows)
    flow = SwitchingFlow(bank, causal=True, judge=lambda nu, sigma: shown.append(nu / sigma))
    flow.push(z, np.ones(rows))
    scores = shown[0][np.isfinite(shown[0])]
    quantiles = np.quantile(np.abs(scores), [0.5, 0.95, 0.99])
    assert quantiles == pytest.approx([0.674, 1.960, 2.576], rel=0.05)
