"""A dial promises a linear filter: sines pass as it says, with noise and spikes about them, and none is cut off."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.steps import in_steps
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.identification.wishes.dial import Dial

RATE_HZ, ROWS, BANDWIDTH_HZ, LAG_S = 100.0, 8000, 0.5, 0.2
TIME_S = np.arange(ROWS) / RATE_HZ
SETTLED = slice(2000, 6000)
NOISE, SPIKE = 0.1, 0.8
DIALS = {
    "smoothed": (False, Dial("bandwidth_hz", BANDWIDTH_HZ)),
    "causal": (True, Dial("bandwidth_hz", BANDWIDTH_HZ)),
    "lag": (True, Dial("max_lag_s", LAG_S)),
}


def gain(signal: Floats, frequency_hz: float) -> float:
    wave = np.exp(-2j * np.pi * frequency_hz * TIME_S[SETTLED])
    return float(2 * abs(np.mean(wave * signal[SETTLED])))


def linear(recipe: ChannelRecipe, sine: Floats, causal: bool) -> Floats:
    assert recipe.motion is not None
    tuning = in_steps(recipe.motion, 1 / RATE_HZ)
    run = kalman_filter if causal else kalman_smoother
    return run(tuning.component.to_model(1.0, tuning.noise_variance), sine).signal[:, 0]


@pytest.mark.parametrize(("times", "share"), [(0.5, 0.01), (1.0, 0.0), (1.0, 0.01), (4.0, 0.01)])
@pytest.mark.parametrize("how", DIALS)
def test_sines_pass_as_the_dial_promised(how: str, times: float, share: float) -> None:
    (causal, dial), frequency_hz = DIALS[how], times * BANDWIDTH_HZ
    rng, sine = np.random.default_rng(round(8 * times)), np.sin(2 * np.pi * frequency_hz * TIME_S)
    spikes = np.where(rng.random(ROWS) < share, SPIKE * rng.choice([-1.0, 1.0], ROWS), 0.0)
    record = Recording(10 * sine + NOISE * rng.normal(size=ROWS) + spikes, rate_hz=RATE_HZ)
    recipe = tune(record, causal=causal, wishes=Wishes(dial=dial))
    out, promised = clean(record, recipe), gain(linear(recipe.channel[0], sine, causal), frequency_hz)
    assert gain(out.signal.samples[:, 0], frequency_hz) / 10 == pytest.approx(promised, rel=0.02, abs=1e-3)
    (verdicts,) = out.verdicts.values()
    assert not np.any(verdicts)
    if times == 1.0 and how != "lag":
        assert promised**2 == pytest.approx(0.5, rel=0.02)


def test_a_filter_as_quick_as_the_identified_one_keeps_its_gate() -> None:
    rng = np.random.default_rng(3)
    walk = np.cumsum(0.02 * rng.normal(size=ROWS))
    spikes = np.where(rng.random(ROWS) < 0.01, 2.0, 0.0)
    record = Recording(walk + NOISE * rng.normal(size=ROWS) + spikes, rate_hz=RATE_HZ)
    enough, quicker = (tune(record, causal=True, wishes=Wishes(dial=Dial("max_lag_s", s))) for s in (1.0, 0.02))
    slower = tune(record, causal=True, wishes=Wishes(dial=Dial("bandwidth_hz", 0.01)))
    assert [one.channel[0].gate is not None for one in (enough, quicker, slower)] == [True, True, False]
    (verdicts,) = clean(record, enough).verdicts.values()
    assert np.count_nonzero(verdicts == Verdict.SPIKE) >= 0.9 * np.count_nonzero(spikes)
