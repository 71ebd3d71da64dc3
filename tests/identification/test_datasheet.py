"""Datasheet numbers become R and q, and come back; the root of two is where it belongs."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.signal import welch

from becalm.core.model.components import level
from becalm.errors import UsageError
from becalm.identification.at_rest.allan import allan_deviation
from becalm.identification.at_rest.allan_terms import noise_terms
from becalm.identification.at_rest.datasheet import (
    convert,
    noise_bandwidth,
    noise_variance,
    quantisation_step,
    quantisation_variance,
    random_walk,
    random_walk_in,
    random_walk_of_stability,
    rms,
    white_noise,
    white_noise_in,
    white_noise_of_rms,
)

ROOT2 = np.sqrt(2)
G = 9.80665


@pytest.mark.parametrize(
    ("value", "unit", "reading_unit", "expected"),
    [
        (60, "ug/sqrt(Hz)", "m/s^2", 60e-6 * G / ROOT2),
        (60, "\u00b5g/\u221aHz", "m/s2", 60e-6 * G / ROOT2),
        (0.06, "mg/rtHz", "g", 60e-6 / ROOT2),
        (0.005, "(deg/s)/sqrt(Hz)", "deg/s", 0.005 / ROOT2),
        (5, "mdps/\u221aHz", "dps", 0.005 / ROOT2),
        (0.005, "\u00b0/s/\u221a(Hz)", "rad/s", 0.005 * np.pi / 180 / ROOT2),
        (20, "deg/h/sqrt(Hz)", "deg/s", 20 / 3600 / ROOT2),
        (0.3, "deg/sqrt(h)", "deg/s", 0.3 / 60),
        (0.3, "\u00b0/\u221ahr", "deg/s", 0.3 / 60),
        (0.06, "(m/s)/sqrt(h)", "m/s^2", 0.06 / 60),
        (0.06, "m/s/sqrt(hr)", "m/s^2", 0.06 / 60),
        (0.01, "um/m/sqrt(Hz)", "um/m", 0.01 / ROOT2),
    ],
)
def test_white_noise_of_a_datasheet(value: float, unit: str, reading_unit: str, expected: float) -> None:
    found = white_noise(value, unit, reading_unit)
    assert found == pytest.approx(expected, rel=1e-12)
    assert white_noise_in(unit, found, reading_unit) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("value", "unit", "reading_unit", "expected"),
    [
        (3, "deg/s/sqrt(h)", "deg/s", 3 / 60),
        (3, "deg/h/sqrt(h)", "deg/s", 3 / 3600 / 60),
        (3, "(ug)/sqrt(s)", "m/s^2", 3e-6 * G),
    ],
)
def test_random_walk_of_a_datasheet(value: float, unit: str, reading_unit: str, expected: float) -> None:
    found = random_walk(value, unit, reading_unit)
    assert found == pytest.approx(expected, rel=1e-12)
    assert random_walk_in(unit, found, reading_unit) == pytest.approx(value, rel=1e-12)


def test_readings_are_converted() -> None:
    assert convert(10, "deg/h", "deg/s") == pytest.approx(10 / 3600, rel=1e-14)
    assert convert(-40, "mg", "m/s^2") == pytest.approx(-0.04 * G, rel=1e-14)


def test_the_root_of_two() -> None:
    """A record of density n_d: Welch's one-sided spectrum reads n_d, Allan N = n_d / sqrt(2), its variance is R."""
    rate, density = 200.0, 80e-6
    white = white_noise(density, "g/sqrt(Hz)", "g")
    variance = noise_variance(white, rate)
    assert variance == pytest.approx(density**2 * rate / 2, rel=1e-14)
    x = np.sqrt(variance) * np.random.default_rng(0).normal(size=2**17)
    _, power = welch(x, rate, nperseg=1024)
    assert np.sqrt(power[5:-5].mean()) == pytest.approx(density, rel=0.01)
    found = noise_terms(allan_deviation(x, rate))
    assert found.white.value == pytest.approx(density / ROOT2, rel=0.02)
    assert found.to_noise_variance(rate) == pytest.approx(variance, rel=0.04)


@pytest.mark.parametrize("poles", [1, 2])
@pytest.mark.parametrize("bandwidth", [1e-6, 0.01, 0.3, 1.0, 5.0])
def test_r_is_the_folded_density(poles: int, bandwidth: float) -> None:
    """The sum of all images, term by term; what is left out beyond them is below the tolerance."""
    images = np.arange(-1_000_000, 1_000_001.0)
    folded = np.sum(1 / (1 + (images / bandwidth) ** (2 * poles)))
    assert noise_variance(3.0, 1.0, bandwidth, poles) == pytest.approx(9.0 * folded, rel=1e-5)


@pytest.mark.parametrize("poles", [1, 2])
def test_r_goes_from_the_rate_to_the_noise_bandwidth(poles: int) -> None:
    assert noise_variance(2.0, 100.0, 1e-9, poles) == pytest.approx(noise_variance(2.0, 100.0), rel=1e-12)
    wide = noise_variance(2.0, 100.0, 1e5, poles)
    assert wide == pytest.approx(rms(2.0, 1e5, poles) ** 2, rel=1e-12)


@pytest.mark.parametrize("poles", [1, 2])
def test_noise_bandwidth_is_the_area_under_the_power(poles: int) -> None:
    area, _ = quad(lambda f: 1 / (1 + (f / 40.0) ** (2 * poles)), 0, np.inf)
    assert noise_bandwidth(40.0, poles) == pytest.approx(area, rel=1e-8)


@given(white=st.floats(1e-9, 1e3), bandwidth=st.floats(1e-3, 1e5), poles=st.sampled_from([1, 2]))
def test_rms_goes_both_ways(white: float, bandwidth: float, poles: int) -> None:
    assert white_noise_of_rms(rms(white, bandwidth, poles), bandwidth, poles) == pytest.approx(white, rel=1e-12)


def test_a_converter_adds_a_twelfth_of_its_squared_step() -> None:
    step = quantisation_step(4.0, 12)
    assert step == 4.0 / 4096
    x = 3 * step * np.random.default_rng(1).normal(size=1_000_000)
    error = np.round(x / step) * step - x
    assert quantisation_variance(step) == pytest.approx(error.var(), rel=0.01)


def test_stability_is_the_lowest_point_of_white_noise_and_random_walk() -> None:
    white, walk = 0.02, 3e-4
    times = np.geomspace(1, 1e5, 20_001)
    lowest = np.sqrt(white**2 / times + walk**2 * times / 3).min()
    assert random_walk_of_stability(float(lowest), white) == pytest.approx(walk, rel=1e-6)


def test_q_is_the_density_of_a_level() -> None:
    walk = random_walk(6.0, "deg/s/sqrt(h)", "deg/s")
    model = level(walk**2).to_model(3600.0, 1.0)
    assert np.sqrt(model.process_covariance[0, 0]) == pytest.approx(6.0, rel=1e-12)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: white_noise(1, "ug/Hz", "g"), "no root of hertz or time"),
        (lambda: white_noise(1, "furlong/sqrt(Hz)", "g"), "'furlong' is not in the table"),
        (lambda: white_noise(1, "ug/sqrt(Hz)", "deg/s"), "'ug' belongs to acceleration, 'deg/s' to angular rate"),
        (lambda: white_noise(1, "deg/sqrt(h)", "m/s^2"), "belongs to angular rate"),
        (lambda: white_noise(1, "ug/sqrt(Hz)", "volt"), "'volt' is not a unit of readings"),
        (lambda: white_noise(1, "deg/s/sqrt(h)", "deg/s"), "use random_walk"),
        (lambda: random_walk(1, "deg/sqrt(h)", "deg/s"), "use white_noise"),
        (lambda: random_walk(1, "deg/s/sqrt(Hz)", "deg/s"), "use white_noise"),
        (lambda: white_noise(-1, "ug/sqrt(Hz)", "g"), "give 0 or a positive number"),
        (lambda: white_noise(np.nan, "ug/sqrt(Hz)", "g"), "give 0 or a positive number"),
        (lambda: convert(np.inf, "g", "mg"), "give a number"),
        (lambda: convert(1, "deg", "deg/s"), "'deg' is not in the table"),
        (lambda: noise_variance(1.0, 0.0), "rate_hz = 0.0"),
        (lambda: noise_variance(1.0, 1.0, 1.0, 3), "poles = 3"),
        (lambda: noise_variance(1.0, 1.0, np.nan), "bandwidth_hz = nan"),
        (lambda: quantisation_step(4.0, 0), "bits = 0"),
        (lambda: quantisation_step(-4.0, 12), "span = -4.0"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(call: object, sentence: str) -> None:
    assert callable(call)
    with pytest.raises(UsageError, match=re.escape(sentence)):
        call()


@pytest.mark.parametrize("unit", ["um/m", "ue", "u\u03b5", "\u03bc\u03b5", "\u00b5\u03b5", "ustrain", "microstrain"])
def test_a_microstrain_is_one_however_it_is_spelled(unit: str) -> None:
    assert convert(1.0, unit, "m/m") == pytest.approx(1e-6, rel=1e-15)
    assert white_noise(1.0, f"{unit}/sqrt(Hz)", "um/m") == pytest.approx(1 / np.sqrt(2), rel=1e-15)
