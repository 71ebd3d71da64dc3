"""Recipes: the text is exact both ways, and what a recipe cannot say is refused in a sentence."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import CalibrationRecipe, ColouredNoiseRecipe, ToneRecipe
from becalm.errors import RecipeError

positive = st.floats(min_value=0, exclude_min=True, allow_nan=False, allow_infinity=False)
uncertainty = st.floats(min_value=0, max_value=1e100, exclude_min=True)
text = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=12)


tones = st.builds(
    ToneRecipe,
    frequency_hz=positive,
    bandwidth_hz=positive,
    process_noise_density=positive,
    disturbance=st.booleans(),
)
coloured = st.builds(
    ColouredNoiseRecipe,
    rate_hz=positive,
    coefficients=st.lists(st.floats(-2, 2), min_size=1, max_size=3).map(tuple),
    std=uncertainty,
)


@st.composite
def channels(draw: st.DrawFn, name: str) -> ChannelRecipe:
    if draw(st.booleans()):
        return ChannelRecipe(name=name, unit=draw(text), model=draw(st.sampled_from(["constant", "untold"])))
    return ChannelRecipe(
        name=name,
        unit=draw(text),
        model="motion",
        order=draw(st.integers(1, 5)),
        process_noise_density=draw(positive | st.just(0.0)),
        noise_std=draw(positive),
        tone=tuple(draw(st.lists(tones, max_size=3))),
        coloured_noise=draw(st.none() | coloured),
        tuning_spread=draw(positive | st.just(0.0)),
        calibration=draw(st.none() | st.builds(CalibrationRecipe, relative_std=uncertainty, offset_std=uncertainty)),
    )


@st.composite
def recipes(draw: st.DrawFn) -> Recipe:
    names = draw(st.lists(text, min_size=1, max_size=4, unique=True))
    return Recipe(
        mode=draw(st.sampled_from(["smoothed", "causal"])),
        time=draw(st.none() | text),
        rate_hz=draw(st.none() | positive),
        tuned_on=Origin(
            sha256=draw(text), rows=draw(st.integers(0, 10**12)), rate_hz=draw(positive), becalm=draw(text)
        ),
        channel=tuple(draw(channels(name)) for name in names),
    )


@given(recipe=recipes())
@settings(max_examples=150)
def test_the_text_says_the_recipe_exactly(recipe: Recipe) -> None:
    written = recipe.to_toml()
    assert Recipe.from_toml(written) == recipe
    assert Recipe.from_toml(written).to_toml() == written
    tomllib.loads(written)  # another reader of TOML takes it too


@given(recipe=recipes())
@settings(max_examples=30)
def test_a_file_says_the_recipe_exactly(recipe: Recipe, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("recipe") / "r.toml"
    path.write_bytes(recipe.to_toml().encode())
    assert Recipe.load(path) == recipe


GOOD = """
becalm_recipe = 1
mode = "smoothed"
[tuned_on]
rows = 100
rate_hz = 50.0
[[channel]]
name = "ax"
unit = "m/s^2"
model = "motion"
order = 2
process_noise_density = 0.5
noise_std = 0.1
"""


def test_a_recipe_by_hand_is_read() -> None:
    recipe = Recipe.from_toml(GOOD)
    assert (recipe.mode, recipe.tuned_on.rate_hz, recipe.time, recipe.rate_hz) == ("smoothed", 50.0, None, None)
    assert recipe.channel == (
        ChannelRecipe(name="ax", unit="m/s^2", model="motion", order=2, process_noise_density=0.5, noise_std=0.1),
    )


FAULTS = [
    ('mode = "smoothed"', 'mode = "backwards"', "mode: Input should be 'smoothed', 'causal' or 'lagged'"),
    ('mode = "smoothed"', 'mode = "smoothed"\nspeed = 3', "speed: Extra inputs are not permitted"),
    ("order = 2", "order = 2\nwindow = 9", "channel.1.window: Extra inputs are not permitted"),
    ("rows = 100", "rows = 100\nby = 'me'", "tuned_on.by: Extra inputs are not permitted"),
    ("order = 2", "order = 6", "channel.1.order: Input should be less than or equal to 5"),
    ("order = 2", "order = 0", "channel.1.order: Input should be greater than or equal to 1"),
    ("order = 2", "order = 1.5", "channel.1.order: Input should be a valid integer"),
    ("order = 2", "", "channel.1: a motion needs order, process_noise_density and noise_std"),
    ("noise_std = 0.1", "noise_std = 0.0", "channel.1.noise_std: Input should be greater than 0"),
    ("noise_std = 0.1", "noise_std = -1", "channel.1.noise_std: Input should be greater than 0"),
    ("noise_std = 0.1", "noise_std = nan", "channel.1.noise_std: Input should be"),
    ("noise_std = 0.1", "noise_std = inf", "channel.1.noise_std: Input should be a finite number"),
    ("noise_std = 0.1", 'noise_std = "much"', "channel.1.noise_std: Input should be a valid number"),
    ("density = 0.5", "density = -0.5", "channel.1.process_noise_density: Input should be greater than or equal to 0"),
    ('model = "motion"', 'model = "magic"', "channel.1.model: Input should be 'motion', 'constant' or 'untold'"),
    ('name = "ax"', "", "channel.1.name: Field required"),
    ("rate_hz = 50.0", "", "tuned_on.rate_hz: Field required"),
    ("rate_hz = 50.0", "rate_hz = 0", "tuned_on.rate_hz: Input should be greater than 0"),
    ("becalm_recipe = 1", "becalm_recipe = 6", "becalm_recipe: Input should be 1, 2, 3, 4 or 5"),
    (
        "noise_std = 0.1",
        "noise_std = 0.1\n[[channel.tone]]\nfrequency_hz = 7",
        "channel.1.tone.1.bandwidth_hz: Field required",
    ),
    (
        "noise_std = 0.1",
        "noise_std = 0.1\n[[channel.tone]]\nfrequency_hz = 0\nbandwidth_hz = 1\nprocess_noise_density = 1",
        "channel.1.tone.1.frequency_hz: Input should be greater than 0",
    ),
    ("[[channel]]", '[[channel]]\nname = "ax"\nmodel = "constant"\n[[channel]]', "two channels have the same name"),
]


@pytest.mark.parametrize(("old", "new", "says"), FAULTS, ids=[new.replace("\n", " ") or old for old, new, _ in FAULTS])
def test_a_wrong_value_is_refused_by_name(old: str, new: str, says: str) -> None:
    assert GOOD.count(old) == 1
    with pytest.raises(RecipeError) as caught:
        Recipe.from_toml(GOOD.replace(old, new))
    message = str(caught.value)
    assert message.startswith("The recipe is not a valid recipe: ")
    assert says in message
    assert "at least 1 item" not in message  # as of a list that counts as empty because of what is in it
    assert message.endswith("Make one with: becalm tune FILE -o R.toml")


@pytest.mark.parametrize(
    ("part", "says"),
    [
        ("[[channel.tone]]\nfrequency_hz = 7.0\nbandwidth_hz = 1.0\nprocess_noise_density = 1.0\n" * 33, "at most 32"),
        (f"[channel.coloured_noise]\nrate_hz = 50.0\nstd = 1.0\ncoefficients = {[0.001] * 65}\n", "at most 64"),
    ],
    ids=["tones", "coefficients"],
)
def test_more_states_than_fit_into_memory_are_refused(part: str, says: str) -> None:
    with pytest.raises(RecipeError, match=f"should have {says} items"):
        Recipe.from_toml(f"{GOOD}{part}")


def test_no_channel_is_refused() -> None:
    with pytest.raises(RecipeError, match="channel: Tuple should have at least 1 item"):
        Recipe.from_toml(GOOD.split("[[channel]]")[0].replace("[tuned_on]", "channel = []\n[tuned_on]"))


@pytest.mark.parametrize(
    "wrong", ["mode = ", "a,b\n1,2\n", "[[[", "= 3", "mode = 'a'\nmode = 'b'", "\x00", "x = 1979-99-99"]
)
def test_what_is_not_toml_is_refused(wrong: str) -> None:
    with pytest.raises(RecipeError, match=r"^The recipe is not TOML \(.*Make one with: becalm tune"):
        Recipe.from_toml(wrong)


@pytest.mark.parametrize("wrong", ["", "x = 1", "[tuned_on]\nrate_hz = 5\n", "channel = 3\n[tuned_on]\nrate_hz = 5"])
def test_toml_that_is_no_recipe_is_refused(wrong: str) -> None:
    with pytest.raises(RecipeError, match=r"^The recipe is not a valid recipe"):
        Recipe.from_toml(wrong)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00mode")
    for path, says in ((tmp_path / "none.toml", "No such file"), (tmp_path, "cannot be read"), (binary, "not UTF-8")):
        with pytest.raises(RecipeError, match=says) as caught:
            Recipe.load(path)
        assert str(path) in str(caught.value)


def test_a_recipe_is_frozen() -> None:
    recipe: Any = Recipe.from_toml(GOOD)
    with pytest.raises(ValueError, match="frozen"):
        recipe.mode = "causal"
