"""Scores of filters with several modes: judged by their whole distribution."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.channels.judging import InnovationJudge, Judgement
from becalm.core.arrays import Floats
from becalm.metrics.whiteness import ScoreCount


def judged(scores: Floats, *, many_modes: bool = True) -> Judgement:
    judge = InnovationJudge(scores=many_modes)
    judge.add(3.0 * scores, 3.0)
    return judge.judgement()


@pytest.mark.parametrize("seed", range(20))
def test_standard_normal_scores_fit(seed: int) -> None:
    assert judged(np.random.default_rng(seed).normal(size=2000)).verdict == "fits"


@pytest.mark.parametrize("seed", range(20))
def test_scores_that_cannot_be_large_are_told_by_their_middle(seed: int) -> None:
    """Of a noise told 1.7 times too small, where another mode expects whatever is far out: no power tells it."""
    scores = np.clip(1.7 * np.random.default_rng(seed).normal(size=2000), -2.5, 2.5)
    assert judged(scores, many_modes=False).verdict == "fits"
    found = judged(scores)
    assert found.verdict == "does not fit"
    assert "% of their probability is misplaced" in found.says


def test_a_scale_misplaces_a_share_that_is_known() -> None:
    scores = np.random.default_rng(1).normal(size=1_000_000)
    shares = [ScoreCount().extended(scale * scores).share() for scale in (1.0, 1.4)]
    assert shares == pytest.approx([0.0, 0.162], abs=0.003)
