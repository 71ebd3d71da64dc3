"""Which recipe is typical of a class, what its sensors keep to, and why others are unlike it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe, LimitsRecipe, ToneRecipe
from becalm.fleet.lake import SensorPlace
from becalm.fleet.outcome import Outcome, refused
from becalm.fleet.tuning.class_differences import reasons
from becalm.fleet.tuning.class_recipe import ClassRecipe, make_class_recipe, medoid
from becalm.fleet.tuning.classes import chosen_of
from becalm.fleet.tuning.limits import limits_of_class
from becalm.fleet.tuning.sensor_tuning import SensorTuning, TunedChannel
from becalm.report.fleet.fleet_rows import FleetRow

LIMITS = LimitsRecipe(stuck_readings=6, even_time=True, drift_threshold=13.0, dead_variance=0.05)


def channel_of(name: str = "v", unit: str = "V", **told: Any) -> ChannelRecipe:
    usual = {"model": "motion", "order": 1, "noise_std": 1.0, "process_noise_density": 4.0, "limits": LIMITS}
    return ChannelRecipe(name=name, unit=unit, **{**usual, **told})


def found_of(
    sensor: str, *channels: ChannelRecipe, verdict: Any = "fits", span: tuple[float, float] = (-9, 9)
) -> SensorTuning:
    """Return what was found for a sensor whose channels all have one verdict."""
    told = [
        TunedChannel(sensor, one, FleetRow(sensor, one.name, one.unit, verdict=verdict, health=1.0), *span)
        for one in channels
    ]
    recipe = Recipe(mode="causal", tuned_on=Origin(sha256=sensor, rate_hz=100.0), channel=channels)
    return SensorTuning(sensor, recipe, tuple(told))


def fleet_of(noises: Sequence[float], **told: Any) -> list[SensorTuning]:
    """Return sensors that differ by their noise."""
    return [found_of(f"s={k}", channel_of(noise_std=noise, **told)) for k, noise in enumerate(noises)]


def recipe_of(found: Sequence[SensorTuning]) -> ClassRecipe:
    told = make_class_recipe(found)
    assert told is not None
    return told


def judged_of(sensor: str, verdict: Any = "fits", health: float = 1.0) -> Outcome:
    return Outcome(sensor, "cleaned", (FleetRow(sensor, "v", "V", verdict=verdict, health=health),))


def judged_all(found: Sequence[SensorTuning]) -> dict[str, Outcome]:
    return {one.sensor: judged_of(one.sensor) for one in found}


@given(
    st.lists(st.tuples(st.floats(-5, 5), st.floats(-50, 50)), min_size=1, max_size=12),
    st.floats(-3, 3),
)
def test_a_medoid_is_the_least_far_from_all_wherever_they_are(places: list[tuple[float, float]], shift: float) -> None:
    far = [sum(math.dist(one, other) for other in places) for one in places]
    assert far[medoid(places)] == pytest.approx(min(far))
    moved = [(noise + shift, density - shift) for noise, density in places]
    assert far[medoid(moved)] == pytest.approx(min(far), abs=1e-9)


def test_a_recipe_is_that_of_a_sensor_and_no_average() -> None:
    told = recipe_of(fleet_of([1.0, 1.1, 1.3, 9.0, 1.2]))
    assert told.recipe.channel[0].noise_std == 1.2
    assert told.sensors == {"v": "s=4"}
    assert told.recipe.tuned_on.sha256 == "s=4"


def test_only_those_of_the_most_frequent_kind_that_fit_are_typical() -> None:
    tone = ToneRecipe(frequency_hz=9.0, bandwidth_hz=0.1, process_noise_density=1.0)
    beside: dict[str, Any] = {"tone": (tone,), "gate": GateRecipe()}
    fleet = [
        *(found_of(f"bad={k}", channel_of(order=3, noise_std=5.0), verdict="does not fit") for k in range(9)),
        *(found_of(f"few={k}", channel_of(order=1, noise_std=4.0)) for k in range(4)),
        *(found_of(f"bare={k}", channel_of(order=2, noise_std=3.0)) for k in range(2)),
        found_of("toned=0", channel_of(order=2, noise_std=1.0, **beside)),
        found_of("toned=1", channel_of(order=2, noise_std=8.0, **beside)),
        found_of("toned=2", channel_of(order=2, noise_std=2.9, **beside)),
        *(found_of(f"still={k}", channel_of(model="constant"), verdict="constant") for k in range(9)),
    ]
    assert recipe_of(fleet).sensors == {"v": "toned=2"}
    assert recipe_of([one for one in fleet if one.channels[0].fits is False]).sensors == {"v": "bad=0"}
    assert recipe_of(fleet[-9:]).recipe.channel[0].model == "constant"


def test_a_recipe_has_the_channels_that_most_sensors_have() -> None:
    temperature = channel_of("temperature", "degC")
    fleet = [
        found_of("s=0", channel_of(noise_std=1.0), temperature),
        found_of("s=1", channel_of(noise_std=2.0)),
        found_of("s=2", temperature, channel_of(noise_std=3.0), channel_of("odd")),
        found_of("s=3", channel_of(unit="mV")),
    ]
    told = recipe_of(fleet)
    assert [channel.name for channel in told.recipe.channel] == ["v"]
    both = recipe_of([*fleet, found_of("s=4", temperature.model_copy(update={"noise_std": 0.1}))])
    assert [channel.name for channel in both.recipe.channel] == ["v", "temperature"]
    assert both.sensors == {"v": "s=1", "temperature": "s=0"}
    assert both.recipe.tuned_on.sha256 == ""
    assert make_class_recipe([found_of("s=0", channel_of("a")), found_of("s=1", channel_of("b"))]) is None


def limits_from(*limits: LimitsRecipe | None, spans: Sequence[tuple[float, float]] = ()) -> LimitsRecipe | None:
    fleet = [
        found_of(f"s={k}", channel_of(limits=one), span=spans[k] if spans else (-9, 9)) for k, one in enumerate(limits)
    ]
    channels = [one.channels[0] for one in fleet]
    return limits_of_class(channels, channels)


def with_limits(**told: Any) -> LimitsRecipe:
    return LIMITS.model_copy(update=told)


def test_one_sensor_keeps_to_its_own_limits() -> None:
    own = with_limits(low=-9.0, high=9.0, resolution=0.5, largest=1e9, gap_steps=4.0)
    assert limits_from(own) == own
    assert limits_from(None) is None


def test_limits_hold_for_all_sensors() -> None:
    slow = with_limits(stuck_readings=40, drift_threshold=30.0, dead_variance=0.01, even_time=False, gap_steps=3.0)
    told = limits_from(LIMITS, slow, LIMITS)
    assert told == with_limits(
        stuck_readings=40, drift_threshold=30.0, dead_variance=0.01, even_time=False, gap_steps=3.0
    )


def test_what_half_of_the_sensors_do_not_tell_is_not_told() -> None:
    unknown = with_limits(stuck_readings=None, drift_threshold=None)
    assert limits_from(LIMITS, unknown) is None
    told = limits_from(LIMITS, unknown, LIMITS)
    assert told is not None
    assert (told.stuck_readings, told.drift_threshold) == (6, 13.0)
    wild = limits_from(LIMITS, LIMITS, with_limits(largest=1e12))
    assert wild is not None
    assert wild.largest == 1e12


@pytest.mark.parametrize(
    ("highs", "beyond", "rail"),
    [
        ([5.0, 5.0, None], 4.0, 5.0),
        ([5.0, None, None], 4.0, None),  # reached by one alone
        ([5.0, 5.0, None], 5.5, None),  # passed by another
        ([5.0, 5.0, 4.5], 4.5, 5.0),
    ],
)
def test_a_rail_is_one_that_two_reached_and_none_passed(
    highs: list[float | None], beyond: float, rail: float | None
) -> None:
    spans = [(-1.0, beyond if high is None else high) for high in highs]
    told = limits_from(*(with_limits(high=high) for high in highs), spans=spans)
    assert told is not None
    assert told.high == rail
    mirrored = [(-high, -low) for low, high in spans]
    lows = [with_limits(low=None if high is None else -high) for high in highs]
    told = limits_from(*lows, spans=mirrored)
    assert told is not None
    assert told.low == (None if rail is None else -rail)


def test_noise_apart_from_its_class_is_a_reason() -> None:
    fleet = fleet_of([1.0, 1.01, 0.99, 1.0, 1.02, 0.98, 1.0, 3.2])
    told = reasons(fleet, recipe_of(fleet), judged_all(fleet))
    assert told == {("s=7", "v"): "Its noise is 3.2 times that of its class."}


def test_a_recipe_that_does_not_describe_a_sensor_is_a_reason_where_it_does_others() -> None:
    scatter = [channel_of(noise_std=noise) for noise in (0.6, 0.7, 1.0, 1.4, 1.7)]
    fleet = [
        found_of("s=0", channel_of(noise_std=1.6)),
        found_of("s=1", channel_of(order=2)),
        found_of("s=2", channel_of(process_noise_density=0.04)),
        found_of("s=3", channel_of(), verdict="does not fit"),
        *(found_of(f"s={4 + k}", one) for k, one in enumerate(scatter)),
        found_of("s=9", channel_of(model="constant"), verdict="constant"),
    ]
    judged = judged_all(fleet) | {
        "s=0": judged_of("s=0", health=2.5),
        "s=1": judged_of("s=1", "does not fit", 1.2),
        "s=2": judged_of("s=2", "does not fit", 0.3),
        "s=3": judged_of("s=3", "does not fit", 1.0),
        "s=9": judged_of("s=9", "does not fit", 0.0),
    }
    told = reasons(fleet, recipe_of(fleet), judged)
    begins = "Its class's recipe does not describe it"
    assert told == {
        ("s=0", "v"): f"{begins} (NIS 2.5, its noise_std is 1.6 times the recipe's).",
        ("s=1", "v"): f"{begins} (NIS 1.2, order 2 where its class has 1).",
        ("s=2", "v"): f"{begins} (NIS 0.3, its process_noise_density is 0.01 times the recipe's).",
        ("s=3", "v"): f"{begins} (NIS 1, its own does not either).",
    }
    few = {sensor: judged_of(sensor, "does not fit") for sensor in judged}
    assert reasons(fleet, recipe_of(fleet), few) == {}


def test_an_order_of_its_own_is_no_reason_where_the_recipe_of_the_class_does_as_well() -> None:
    fleet = [*fleet_of([1.0] * 8), found_of("s=8", channel_of(order=2))]
    assert reasons(fleet, recipe_of(fleet), judged_all(fleet)) == {}


def test_other_channels_than_those_of_the_class_are_a_reason() -> None:
    fleet = [*fleet_of([1.0] * 3), found_of("s=3", channel_of(), channel_of("w")), found_of("s=4", channel_of("u"))]
    judged = judged_all(fleet) | {"s=4": refused("s=4", "It has no channel 'v'.")}
    told = reasons(fleet, recipe_of(fleet), judged)
    rare = "Few sensors of its class have this channel, so the recipe of its class passes it unchanged."
    assert told == {("s=3", "w"): rare, ("s=4", "u"): "Its class's recipe does not run on it: It has no channel 'v'."}
    assert set(reasons(fleet[-2:], None, {})) == {("s=3", "v"), ("s=3", "w"), ("s=4", "u")}


def test_sensors_to_tune_are_spread_by_name() -> None:
    places = [SensorPlace(f"sensor={k}", 1) for k in range(101)] + [SensorPlace("kind=pump/sensor=1", 1)]
    pump, usual = sorted(chosen_of(places, 5), key=lambda one: one.sensors)
    assert (pump.name, pump.sensors, [place.name for place in pump.places]) == ("kind=pump", 1, ["kind=pump/sensor=1"])
    assert (usual.name, usual.sensors) == ("default", 101)
    assert [place.name for place in usual.places] == [f"sensor={k}" for k in (0, 25, 50, 75, 100)]
    assert [len(one.places) for one in chosen_of(places)] == [101, 1]
