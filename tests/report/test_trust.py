"""Innovations are drawn as they were judged."""

from __future__ import annotations

import json

import numpy as np
import pytest

from becalm.cleaning.channels.judging import InnovationJudge
from becalm.cleaning.channels.report import ChannelReport
from becalm.metrics.whiteness import LaggedSums
from becalm.report.data.description import Curve, Figure
from becalm.report.data.envelope import Envelope, Means
from becalm.report.innovation_figures import innovation_figures
from becalm.report.pictures import Title


def drawn(sums: LaggedSums | None) -> tuple[Figure, ...]:
    return innovation_figures(Title("1-a", "a", "m"), Envelope(1), sums, Means(1), 100.0)


@pytest.mark.parametrize(("rows", "lags"), [(100_000, 32), (100, 12), (8, 1)])
def test_the_autocorrelation_is_that_of_what_was_judged(rows: int, lags: int) -> None:
    e = np.random.default_rng(5).normal(0, 0.2, rows)
    judge = InnovationJudge()
    judge.add(e, 0.2)
    whiteness, *_ = drawn(judge.judgement().lagged)
    curve = whiteness.layers[0]
    assert isinstance(curve, Curve)
    about = e - e.mean()
    expected = [about[lag:] @ about[: rows - lag] / (about @ about) for lag in range(1, lags + 1)]
    np.testing.assert_allclose(curve.y, expected, rtol=1e-9, atol=1e-12)


def test_of_too_few_innovations_nothing_is_drawn() -> None:
    judge = InnovationJudge()
    judge.add(np.ones(7), 1.0)
    assert judge.judgement().lagged is None
    assert drawn(None) == ()


def test_what_was_judged_by_is_not_told_in_json() -> None:
    report = ChannelReport(lagged=LaggedSums().extended(np.arange(100.0)))
    assert "lagged" not in json.loads(json.dumps(report.as_dict()))
