"""Scores of readings by what several modes expect: standard normal where the bank is right."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtri

from banks import new_trace
from becalm.core.arrays import Floats
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import motion
from becalm.native.imm import filter_rows, new_state


def test_a_normal_score_is_the_normal_quantile() -> None:
    """Of one mode the innovation is what the measurement differs by; of two that expect alike, so far as they go."""
    scores = np.concatenate([-ndtri(np.logspace(-299, -1, 50)), [0.5, 1e-3, 0.0]])
    for one in (motion(1, 1e-12), motion(2, 1e-12)):
        alike = [Mode(name, one, 1.0, 100.0) for name in ("one", "other")]
        for modes in (alike[:1], alike):
            bank = InteractingModels(tuple(modes)).matrices(np.ones(1))
            for score in [*scores, *-scores]:
                trace = new_trace(InteractingModels(tuple(modes)), 2)
                filter_rows(bank, new_state(bank, keeps_level=False), np.zeros(2), np.zeros(2, np.int32), trace)
                sigma = trace.innovation_sigma[1]
                z = np.array([0.0, score * sigma])
                filter_rows(bank, new_state(bank, keeps_level=False), z, np.zeros(2, np.int32), trace)
                assert trace.innovation[1] == pytest.approx(score * sigma, rel=1e-12, abs=1e-12)


def test_scores_are_standard_normal_though_levels_jump_and_readings_are_wild() -> None:
    rng, shown, rows = np.random.default_rng(3), list[Floats](), 20_000
    still = Mode("still", motion(1, 1e-9), 1.0, 100.0, wild_share=0.02)
    jump = Mode("jump", motion(1, 3600.0), 1.0, 0.7, "still", 0.02)
    bank = InteractingModels((still, jump), 4e4, rejects=True)
    to_jump, mode = bank.transitions(np.ones(1))[0, :, 1], np.zeros(rows, int)
    for k in range(1, rows):
        mode[k] = rng.random() < to_jump[mode[k - 1]]
    wild = rng.random(rows) < 0.02
    z = np.cumsum(60 * mode * rng.normal(size=rows)) + rng.normal(size=rows) + 200 * wild * rng.normal(size=rows)
    flow = ImmFlow(bank, causal=True, judge=lambda nu, sigma: shown.append(nu / sigma))
    flow.push(z, np.ones(rows))
    scores = shown[0][np.isfinite(shown[0])]
    quantiles = np.quantile(np.abs(scores), [0.5, 0.95, 0.99])
    assert quantiles == pytest.approx([0.674, 1.960, 2.576], rel=0.05)
