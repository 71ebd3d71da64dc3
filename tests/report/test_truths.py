"""What a report says and draws is true of the filter that ran, in every mode."""

from __future__ import annotations

import re

import numpy as np
import pytest

from becalm.cleaning.pipeline import in_mode
from becalm.cleaning.tuning import tune
from becalm.core.recording import Recording
from becalm.report.channel import Pictured
from becalm.report.data.description import Band, Curve, Figure, Lane
from becalm.report.pictures import Title, break_at_pauses
from becalm.report.running import pictures_of
from drawing import draw

RATE_HZ = 100.0


def noisy(rows: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    rng = np.random.default_rng(11)
    return np.cumsum(rng.normal(0, 0.05, rows)) + rng.normal(0, 0.3, rows)


def figure_of(pictured: Pictured, ending: str) -> Figure:
    return next(figure for figure in (*pictured.wide, *pictured.narrow) if figure.name.endswith(ending))


@pytest.mark.parametrize(
    ("name", "unit", "label"),
    [
        ("momentum", "m", "momentum (m)"),
        ("acc [m/s²]", "m/s^2", "acc [m/s²]"),
        ("x (µm/m)", "um/m", "x (µm/m)"),
        ("x (left)", "V", "x (left) (V)"),
        ("x", "", "x"),
    ],
)
def test_an_axis_has_its_unit_once(name: str, unit: str, label: str) -> None:
    assert Title("x", name, unit).axis == label


def test_a_lagged_filter_is_not_told_as_the_smoother() -> None:
    recording = Recording(noisy(3000), names=["a"], units=["V"], rate_hz=RATE_HZ)
    recipe = in_mode(tune(recording, causal=True), None, 0.1)
    pictured = pictures_of(recording, recipe).channel(0)
    chosen = next(layer for layer in figure_of(pictured, "-front").layers if layer.name == "chosen")
    assert isinstance(chosen, Curve)
    down = re.search(r"With a delay of 0\.1 s, noise is down ([0-9.]+) dB", pictured.words)
    assert down is not None, pictured.words
    assert pictured.report.noise_std is not None
    assert float(down[1]) == pytest.approx(-20 * np.log10(chosen.y[0] / pictured.report.noise_std), abs=0.051)


def test_of_a_constant_channel_no_sigma_is_believed() -> None:
    both = np.column_stack([noisy(2000), np.full(2000, 3.5)])
    html = draw(Recording(both, names=["a", "b"], rate_hz=RATE_HZ)).page()
    lead = re.search(r'<p class="lead">(.*?)</p>', html)
    assert lead is not None
    assert "1 of 2 channels are constant; their sigma is unknown" in lead[1]
    assert '<td class="">see below</td>' in html
    assert '"2-b-closeup-2"' not in html, "no reading lies any sigma away"


@pytest.mark.parametrize(("rows", "lost"), [(900, 417), (20_000, 8000), (20_000, 8003)])
def test_nothing_is_drawn_where_time_pauses(rows: int, lost: int) -> None:
    times_s = np.arange(rows) / RATE_HZ
    times_s[lost:] += 60.0
    z = noisy(rows)
    z[lost - 40 : lost] = np.nan
    recording = Recording(z, names=["a"], times_s=times_s)
    pictured = pictures_of(recording, tune(recording)).channel(0)
    usual_s = 1.01 * (rows // 3000 + 1) / RATE_HZ
    for layer in figure_of(pictured, "-signal").layers:
        assert isinstance(layer, Band)
        across = np.diff(layer.x) > 10
        assert across.sum() == 1
        assert np.isnan(layer.low[np.append(across, False)]).all()
    missing = next(layer for layer in figure_of(pictured, "-verdicts").layers if layer.name == "missing")
    assert isinstance(missing, Lane)
    if lost % (rows // 3000 + 1) == 0:  # else one stretch holds rows of both sides
        assert missing.ends.max() < times_s[lost - 1] + usual_s
    nis = figure_of(pictured, "-nis").layers[0]
    assert isinstance(nis, Curve)
    assert not ((nis.x > times_s[lost - 1] + 2) & (nis.x < times_s[lost])).any()


def test_without_a_pause_arrays_stay_the_same() -> None:
    x = np.arange(50.0)
    assert break_at_pauses(x, x)[0] is x
    repeated = np.floor(x / 2)
    assert break_at_pauses(repeated, x)[1] is x


def test_a_step_is_shown_until_it_settles_beside_a_tone() -> None:
    t = np.arange(6000) / RATE_HZ
    z = 0.2 * noisy(6000) + np.sin(2 * np.pi * 20 * t)
    recording = Recording(z, names=["a"], rate_hz=RATE_HZ)
    recipe = tune(recording)
    assert recipe.channel[0].tone, "the tone is found"
    output = figure_of(pictures_of(recording, recipe).channel(0), "-step").layers[1]
    assert isinstance(output, Curve)
    assert np.abs(output.y[-len(output.y) // 10 :] - 1).max() < 0.1


def test_of_a_filter_that_switches_no_mode_stands_for_all() -> None:
    rng = np.random.default_rng(3)
    z = rng.normal(0, 0.1, 20_000)
    for start in (2000, 7000, 12_000, 17_000):
        z[start : start + 1500] += 5 * np.hanning(1500) * np.sin(2 * np.pi * np.arange(1500) / 100)
    recording = Recording(z, names=["a"], rate_hz=RATE_HZ)
    pictured = pictures_of(recording, tune(recording)).channel(0)
    assert pictured.report.modes, "it switches"
    assert not [figure for figure in pictured.narrow if figure.name.endswith("-front")], "none of it is known"
    step = figure_of(pictured, "-step").layers[0]
    assert isinstance(step, Curve)
    quickest_hz = max(mode.bandwidth_hz or 0.0 for mode in pictured.report.modes.values())
    assert step.x[-1] < 5 / quickest_hz
