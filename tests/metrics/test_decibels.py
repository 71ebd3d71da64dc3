"""Decibels in two conventions, each under its own name."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.metrics.decibels import snr_db, snr_paper_db


def test_the_papers_decibel_is_twice_the_usual_one() -> None:
    signal, noise = np.array([3.0, -3.0, np.nan]), np.array([0.3, -0.3, 0.3])
    assert snr_db(signal, noise) == pytest.approx(20.0)
    assert snr_paper_db(signal, noise) == pytest.approx(40.0)
