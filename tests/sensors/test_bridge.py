"""Strain is what resistors say: every bridge beside a Wheatstone bridge of exact fractions, and against sheets."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.errors import SensorError
from becalm.sensors.bridge import CONFIGURATIONS, Bridge, Configuration, Shunt, gain_adjustment, shunt_strain

GAUGE = Fraction(350)
STRAINS = [sign * size for size in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2) for sign in (-1, 1)]


def arms(configuration: Configuration, strain: float, gauge_factor: float, nu: float) -> list[Fraction]:
    """Return what R1 to R4 change by, relatively: 0 where an arm is a resistor, or a gauge that is not strained."""
    along = Fraction(strain) * Fraction(gauge_factor)
    across, none = -Fraction(nu) * along, Fraction(0)
    return {
        "quarter I": [none, none, none, along],
        "quarter II": [none, none, none, along],  # R3 is the dummy: it sees the temperature, not the strain
        "half I": [none, none, across, along],
        "half II": [none, none, -along, along],
        "full I": [-along, along, -along, along],
        "full II": [across, -across, -along, along],
        "full III": [across, along, across, along],
    }[configuration]


def wheatstone(changes: list[Fraction], lead_ohm: float = 0.0) -> float:
    """Return the ratio of a bridge of which R3 and R4 each have a lead in series."""
    lead = Fraction(lead_ohm)
    r1, r2, r3, r4 = (GAUGE * (1 + change) for change in changes)
    r3, r4 = r3 + lead, r4 + lead
    return float(r3 / (r3 + r4) - r2 / (r1 + r2))


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
@pytest.mark.parametrize("gauge_factor", [1.8, 2.0, 2.1, 3.2])
@pytest.mark.parametrize("nu", [0.0, 0.285, 0.33, 0.5])
def test_every_bridge_tells_the_strain_of_its_resistors(
    configuration: Configuration, gauge_factor: float, nu: float
) -> None:
    ratios = np.array([wheatstone(arms(configuration, strain, gauge_factor, nu)) for strain in STRAINS])
    bridge = Bridge(configuration, gauge_factor, nu)
    np.testing.assert_allclose(bridge.strain(ratios), STRAINS, rtol=1e-12, atol=0)
    swapped = Bridge(configuration, gauge_factor, nu, tension_lowers=False)
    np.testing.assert_allclose(swapped.strain(-ratios), STRAINS, rtol=1e-12, atol=0)


@pytest.mark.parametrize("configuration", ["quarter I", "quarter II", "half I", "half II"])
def test_the_lead_factor_restores_what_leads_take(configuration: Configuration) -> None:
    ratios = np.array([wheatstone(arms(configuration, strain, 2.1, 0.3), 5.0) for strain in STRAINS])
    np.testing.assert_allclose(Bridge(configuration, 2.1, 0.3, lead_ohm=5.0).strain(ratios), STRAINS, rtol=1e-10)
    low = Bridge(configuration, 2.1, 0.3).strain(ratios) / STRAINS - 1
    np.testing.assert_allclose(low, -5 / 355, rtol=1e-9)
    assert f"{100 * low[0]:.2f}" == "-1.41"


def test_the_short_form_errs_as_the_sheet_says() -> None:
    """A linear quarter bridge is wrong by G strain / 2: 0.105 % at 1000 um/m, 1.05 % at 10 000."""
    for strain, percent in ((1e-3, 0.105), (1e-2, 1.05)):
        linear = -4 * wheatstone(arms("quarter I", strain, 2.1, 0.3)) / 2.1
        assert 100 * (1 - linear / strain) == pytest.approx(percent, rel=0.02)


@given(
    configuration=st.sampled_from(CONFIGURATIONS),
    strain=st.floats(-1e-2, 1e-2),
    initial=st.floats(-1e-3, 1e-3),
    excitation_v=st.floats(0.5, 10.0),
)
def test_the_zero_and_the_supply_drop_out(
    configuration: Configuration, strain: float, initial: float, excitation_v: float
) -> None:
    balanced = wheatstone(arms(configuration, strain, 2.1, 0.3))
    bridge = Bridge(configuration, 2.1, 0.3, excitation_v, initial_ratio=initial)
    voltage = np.array([excitation_v * (balanced + initial)])
    np.testing.assert_allclose(bridge.strain(bridge.ratio(voltage)), [strain], atol=1e-14)


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
@pytest.mark.parametrize("tension_lowers", [True, False])
def test_the_slope_is_that_of_the_strain(configuration: Configuration, tension_lowers: bool) -> None:
    bridge = Bridge(configuration, 2.1, 0.3, lead_ohm=2.0, initial_ratio=1e-4, tension_lowers=tension_lowers)
    ratio, step = np.linspace(-0.02, 0.02, 9), 1e-6
    expected = (bridge.strain(ratio + step) - bridge.strain(ratio - step)) / (2 * step)
    np.testing.assert_allclose(bridge.slope(ratio), expected, rtol=1e-8)


def test_a_ratio_that_no_gauge_gives_is_missing() -> None:
    strain = Bridge("quarter I", 2.0).strain(np.array([-0.5, -0.7, np.nan, 0.0]))
    np.testing.assert_array_equal(np.isnan(strain), [True, True, True, False])


def test_a_shunt_simulates_what_its_resistors_say() -> None:
    simulated = shunt_strain(350.0, 174_650.0, 2.1)
    assert simulated == pytest.approx(-952.381e-6, abs=5e-10)
    shunted = 1 / (1 / GAUGE + Fraction(1, 174_650)) / GAUGE - 1
    ratio = np.array([wheatstone([Fraction(0), Fraction(0), Fraction(0), shunted])])
    np.testing.assert_allclose(Bridge("quarter I", 2.1).strain(ratio), simulated, rtol=1e-12)
    assert gain_adjustment(simulated, 0.98 * simulated) == pytest.approx(1 / 0.98)
    adjusted = Bridge("quarter I", 2.1, gain_adjustment=gain_adjustment(simulated, 0.98 * simulated))
    np.testing.assert_allclose(adjusted.strain(ratio), simulated / 0.98, rtol=1e-12)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"configuration": "half III"}, "is not a bridge"),
        ({"configuration": "full III"}, "give poisson_ratio"),
        ({"gauge_factor": 0.0}, "gauge_factor = 0.0 is not a positive number"),
        ({"gauge_factor": True}, "gauge_factor"),
        ({"lead_ohm": float("nan")}, "lead_ohm = nan is not zero or a positive"),
        ({"excitation_v": -5.0}, "excitation_v"),
        ({"initial_ratio": float("inf")}, "initial_ratio = inf is not a finite"),
    ],
)
def test_an_impossible_bridge_is_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(SensorError, match=said):
        Bridge(**({"configuration": "quarter I", "gauge_factor": 2.1} | given))  # type: ignore[arg-type]


def test_volts_need_the_excitation() -> None:
    with pytest.raises(SensorError, match="give excitation_v"):
        Bridge("quarter I", 2.1).ratio(np.zeros(3))


@pytest.mark.parametrize("read", [952e-6, -100e-6, 0.0])
def test_a_shunt_that_no_gain_explains_is_refused(read: float) -> None:
    with pytest.raises(SensorError, match="no gain explains"):
        gain_adjustment(-952e-6, read)


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
@pytest.mark.parametrize("tension_lowers", [True, False])
def test_a_shunt_restores_what_an_amplifier_loses(configuration: Configuration, tension_lowers: bool) -> None:
    """The resistor lies across the gauge in tension; the amplifier gives 0.97 of the ratio, and an offset."""
    none, sign, lead = Fraction(0), 1 if tension_lowers else -1, 0.0 if configuration.startswith("full") else 2.0
    shunted = 1 / (1 / GAUGE + Fraction(1, 174_650)) / GAUGE - 1

    def read(changes: list[Fraction]) -> float:
        return sign * 0.97 * wheatstone(changes, lead) + 3e-4

    bridge = Bridge(
        configuration,
        2.1,
        0.3,
        lead_ohm=lead,
        tension_lowers=tension_lowers,
        shunt=Shunt(174_650.0, read([none, none, none, shunted])),
    ).zeroed_at(read([none] * 4))
    assert bridge.gain == pytest.approx(1 / 0.97, rel=1e-3)
    strains = np.array([-1e-3, 1e-4, 1e-3])
    ratios = np.array([read(arms(configuration, strain, 2.1, 0.3)) for strain in strains])
    np.testing.assert_allclose(bridge.strain(ratios), strains, rtol=1e-3)


def test_a_shunt_of_another_zero_is_refused_when_needed() -> None:
    with pytest.raises(SensorError, match="no gain explains"):
        Bridge("quarter I", 2.1, shunt=Shunt(174_650.0, -5e-4)).strain(np.zeros(1))
    with pytest.raises(SensorError, match="shunt_ohm = 0"):
        Bridge("quarter I", 2.1, shunt=Shunt(0, 5e-4))
