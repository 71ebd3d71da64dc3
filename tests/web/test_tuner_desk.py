"""What is set, and what a recipe makes of it: choices, components, dials, undone and done again."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.channels.excerpt import ChannelRows
from becalm.cleaning.dial_positions import POSITIONS, dial, summary_of
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import TimingRecipe
from becalm.cleaning.recipes.steps import in_steps
from becalm.cleaning.tuning import ChannelTuning, explore, tune
from becalm.core.filter.likelihood import log_likelihood
from becalm.errors import RecipeError, UsageError
from becalm.identification.choose import Choice
from becalm.identification.likelihood import Evidence, Tuning
from becalm.web.tuner.costs import cost_map
from becalm.web.tuner.evidence import compared_with_best, describe_model
from becalm.web.tuner.messages import SettingChanges
from becalm.web.tuner.opened import OpenRecording
from becalm.web.tuner.settings import FOUND, GIVEN, Options, Setting, components
from becalm.web.tuner.view_model import ViewModel
from tuner_records import COLOURED, GATE, LIMITS, RATE_HZ, SWITCHING, TONES, even, motion, walk
from tuner_served import drive_in

ALARMED = LIMITS.model_copy(update={"drift_threshold": 20.0})
RICH = motion(
    order=2,
    process_noise_density=3.0,
    tuning_spread=0.05,
    tone=TONES,
    coloured_noise=COLOURED,
    gate=GATE,
    limits=ALARMED,
    timing=TimingRecipe(std_s=1e-4, included_std=0.1),
)
RIVALS = (Tuning(1, 1e-3, 0.3, 5000, loss=-1.0), Tuning(2, 1e-6, 0.25, 5000, loss=-1.1))


@pytest.fixture
def options() -> Options:
    evidence = Evidence.of(walk(), np.ones(30_000))
    return Options(
        ChannelTuning(RICH, Choice("motion", RIVALS[1], RIVALS[1], RIVALS), evidence), RICH, 1 / RATE_HZ, False
    )


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> OpenRecording:
    return OpenRecording("id", drive_in(tmp_path_factory.mktemp("desk")), None, lambda _: None)


@pytest.fixture
def desk(opened: OpenRecording) -> ViewModel:
    return ViewModel(opened)


def test_nothing_set_is_what_was_found(options: Options) -> None:
    assert options.recipe(Setting()) == RICH
    told = options.as_dict(Setting())
    assert (told["choice"], told["order"], told["unchanged"]) == (FOUND, 2, False)
    assert told["on"] == dict.fromkeys(("tone-0", "tone-1", "coloured", "gate", "limits", "timing"), True)


@pytest.mark.parametrize(
    ("key", "field", "left"),
    [
        ("tone-0", "tone", TONES[1:]),
        ("tone-1", "tone", TONES[:1]),
        ("coloured", "coloured_noise", None),
        ("gate", "gate", None),
        ("limits", "limits", None),
        ("timing", "timing", None),
    ],
)
def test_a_component_is_switched_off_and_on(options: Options, key: str, field: str, left: object) -> None:
    off = options.changed(Setting(), SettingChanges(on={key: False}))
    assert getattr(options.recipe(off), field) == left
    told = options.as_dict(off)["on"]
    assert isinstance(told, dict)
    assert [one for one, on in told.items() if not on] == [key]
    assert options.changed(off, SettingChanges(on={key: True})) == Setting()


def test_a_dial_set_by_hand_has_no_spread_and_no_alarms(options: Options) -> None:
    set_ = options.changed(Setting(), SettingChanges(process_noise_density=7.0))
    recipe = options.recipe(set_)
    assert (recipe.process_noise_density, recipe.noise_std, recipe.tuning_spread) == (7.0, 0.5, 0.0)
    assert recipe.limits is not None
    assert recipe.limits.drift_threshold is None
    assert recipe.limits.low == LIMITS.low
    assert recipe.tone == TONES
    quieter = options.recipe(options.changed(set_, SettingChanges(noise_std=0.01)))
    assert (quieter.process_noise_density, quieter.noise_std) == (7.0, 0.01)
    assert quieter.timing is not None
    assert quieter.timing.included_std == 0.01
    assert options.changed(set_, SettingChanges(choice=FOUND)) == Setting()


def test_another_order_has_the_numbers_that_were_tuned_for_it(options: Options) -> None:
    recipe = options.recipe(options.changed(Setting(), SettingChanges(choice="order-1")))
    assert recipe.order == 1
    assert recipe.noise_std == pytest.approx(np.sqrt(0.3))
    assert recipe.process_noise_density == pytest.approx(0.3e-3 * RATE_HZ)
    assert recipe.tone == TONES
    with pytest.raises(UsageError, match="no model 'order-7'"):
        options.changed(Setting(), SettingChanges(choice="order-7"))
    with pytest.raises(UsageError, match="no component 'gates'"):
        options.changed(Setting(), SettingChanges(on={"gates": False}))


def test_turning_the_dial_of_what_switches_makes_it_one_filter() -> None:
    switching = motion(process_noise_density=0.3, switching=SWITCHING)
    found = ChannelTuning(switching, Choice("motion", rivals=RIVALS), Evidence.of(walk(), np.ones(30_000)))
    options = Options(found, switching, 1 / RATE_HZ, False)
    turned = options.changed(Setting(), SettingChanges(noise_std=0.4))
    assert options.recipe(turned).switching is None
    assert options.as_dict(turned)["on"] == {"switching": False}
    again = options.changed(turned, SettingChanges(on={"switching": True}))
    assert options.recipe(again) == switching
    fixed = options.changed(Setting(), SettingChanges(choice="order-2"))
    assert options.as_dict(fixed)["on"] == {"switching": False}
    assert options.recipe(options.changed(fixed, SettingChanges(on={"switching": True}))) == switching


def test_what_passes_unchanged_has_no_dial() -> None:
    constant = ChannelRecipe(name="ax", model="constant")
    options = Options(
        ChannelTuning(constant, Choice("constant"), Evidence.of(walk(), np.ones(30_000))), constant, 1e-3, False
    )
    assert options.as_dict(Setting())["unchanged"]
    with pytest.raises(UsageError, match="passes unchanged"):
        options.changed(Setting(), SettingChanges(noise_std=1.0))
    assert dial(constant, 1e-3, None, 1000) == {}


@pytest.mark.parametrize(
    "setting",
    [
        Setting(),
        Setting(off=frozenset({"tone-0", "gate"})),
        Setting("order-1"),
        Setting("order-1", 0.2, 0.7, frozenset({"limits"})),
        Setting(FOUND, 0.2, 0.7),
    ],
)
def test_a_recipe_is_read_back_as_what_was_set(options: Options, setting: Setting) -> None:
    assert options.simplest_setting(options.recipe(setting)) == setting


def test_a_recipe_of_another_hand_is_kept_as_it_is(options: Options) -> None:
    strange = RICH.model_copy(update={"order": 5, "process_noise_density": 1e12, "tuning_spread": 0.3})
    setting = options.simplest_setting(strange)
    assert setting.choice == GIVEN
    assert options.recipe(setting) == strange
    calmer = options.recipe(options.changed(setting, SettingChanges(process_noise_density=1e6)))
    assert (calmer.order, calmer.process_noise_density) == (5, 1e6)


def test_components_have_names_for_people() -> None:
    assert components(RICH)["tone-0"] == "tone at 50 Hz"
    assert components(motion(process_noise_density=1.0)) == {}


def test_evidence_is_told_in_words() -> None:
    assert compared_with_best(RIVALS) == {
        1: "estimates a left-out reading 5.1 % worse",
        2: "estimates a left-out reading as well as any",
    }
    filters = (Tuning(1, 1.0, 1.0, 1000, -1500.0), Tuning(2, 1.0, 1.0, 1000, -1400.0), Tuning(3, 1.0, 1.0, 0, -np.inf))
    assert compared_with_best(filters) == {
        1: "predicts the next reading 11 % worse",
        2: "predicts the next reading as well as any",
        3: "predicts the next reading far worse",
    }
    assert describe_model(RICH) == "order 2 with a tone at 50 Hz, a tone at 120 Hz, coloured noise"


def test_steps_are_taken_back_and_done_again(desk: ViewModel) -> None:
    recipes = [desk.recipe()]
    for density in (1.0, 2.0):
        desk.turn(0, SettingChanges(process_noise_density=density), final=True)
        recipes.append(desk.recipe())
    desk.turn(0, SettingChanges(process_noise_density=9.0), final=False)
    assert desk.recipe().channel[0].process_noise_density == 9.0
    desk.undo()  # what was dragged goes with the step before it
    assert desk.recipe() == recipes[1]
    desk.undo()
    desk.undo()
    assert desk.recipe() == recipes[0]
    assert not desk.can_undo
    desk.redo()
    assert desk.recipe() == recipes[1]
    desk.turn(1, SettingChanges(on={}, noise_std=3.0), final=True)
    assert not desk.can_redo
    desk.turn(1, SettingChanges(noise_std=3.0), final=True)  # says nothing new
    desk.undo()
    assert desk.recipe() == recipes[1]


def test_what_was_found_is_what_tune_finds(desk: ViewModel) -> None:
    found = tune(desk.opened.recording)
    assert desk.recipe().channel == found.channel
    assert explore(desk.opened.recording).recipe == found
    desk.set_mode("causal", None)
    assert desk.recipe().channel == tune(desk.opened.recording, causal=True).channel
    assert desk.recipe().mode == "causal"


def test_a_channel_that_is_left_as_it_is_is_not_in_the_recipe(desk: ViewModel) -> None:
    desk.turn(0, SettingChanges(unchanged=True), final=True)
    assert [channel.name for channel in desk.recipe().channel] == ["load"]
    text = desk.recipe().to_toml()
    desk.turn(1, SettingChanges(unchanged=True), final=True)
    with pytest.raises(UsageError, match="No channel is left"):
        desk.recipe()
    assert desk.state_message()["recipe"] == ""
    desk.restore(text)
    assert desk.recipe().to_toml() == text
    for _ in range(3):
        desk.undo()
    assert len(desk.recipe().channel) == 2


def test_a_recipe_of_another_recording_is_refused(desk: ViewModel) -> None:
    recipe = desk.recipe()
    renamed = recipe.channel[0].model_copy(update={"name": "ay"})
    with pytest.raises(RecipeError, match="does not have"):
        desk.restore(recipe.model_copy(update={"channel": (renamed,)}).to_toml())
    other = recipe.channel[0].model_copy(update={"unit": "V"})
    with pytest.raises(RecipeError, match="in 'V'"):
        desk.restore(recipe.model_copy(update={"channel": (other,)}).to_toml())
    assert desk.recipe() == recipe


@pytest.mark.parametrize("lag", [None, 0, 20])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_a_dial_goes_from_quick_to_calm(order: int, lag: int | None) -> None:
    channel = motion(order=order, process_noise_density=1.0)
    found = dial(channel, 1 / RATE_HZ, lag, 1_000_000)
    assert {len(values) for values in found.values()} == {POSITIONS}
    known = np.isfinite(found["noise_left"])
    assert known.sum() > 60
    assert (np.diff(found["noise_left"][known]) < 1e-9).all()
    assert (found["noise_left"][known] <= 0.5 * (1 + 1e-9)).all()
    middle = POSITIONS // 2
    set_ = channel.model_copy(update={"process_noise_density": float(found["process_noise_density"][middle])})
    told = summary_of(set_, 1 / RATE_HZ, lag)
    assert told.noise_left == pytest.approx(found["noise_left"][middle], rel=1e-6)
    if not lag:
        assert told.bandwidth_hz == pytest.approx(found["bandwidth_hz"][middle], rel=1e-6)
    assert told.lag_s == pytest.approx(found["lag_s"][middle], rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("damped_below_hz", [None, 0.1])
@pytest.mark.parametrize("tones", [(), TONES])
def test_a_map_is_what_the_likelihood_says(tones: tuple[object, ...], damped_below_hz: float | None) -> None:
    rng = np.random.default_rng(11)
    z = np.cumsum(rng.normal(size=15_000)) * 0.05 + rng.normal(size=15_000)
    rows = ChannelRows(z, even(z).timebase.elapsed_steps, 1 / RATE_HZ)
    density = RATE_HZ * 0.05**2 * 30
    channel = motion(process_noise_density=density, noise_std=0.5, tone=tones, damped_below_hz=damped_below_hz)
    found = cost_map(rows, channel)
    assert found.cost.min() == 0.0 == found.cost[found.best]
    if not tones:
        assert found.noise_std[found.best[0]] == pytest.approx(1.0, rel=0.15)
        assert found.process_noise_density[found.best[1]] == pytest.approx(RATE_HZ * 0.05**2, rel=0.6)
    here = (
        int(np.argmin(np.abs(found.noise_std - 0.5))),
        int(np.argmin(np.abs(np.log(found.process_noise_density / found.here[1])))),
    )

    def cost(place: tuple[int, int]) -> float:
        noise, density = float(found.noise_std[place[0]]), float(found.process_noise_density[place[1]])
        scale = (noise / 0.5) ** 2
        beside = tuple(
            tone.model_copy(update={"process_noise_density": tone.process_noise_density * scale})
            for tone in channel.tone
        )
        set_ = channel.model_copy(update={"noise_std": noise, "process_noise_density": density, "tone": beside})
        assert set_.motion is not None
        tuning = in_steps(set_.motion, 1 / RATE_HZ)
        return -log_likelihood(tuning.component.to_model(1.0, tuning.noise_variance), z) / len(z)

    elsewhere = here[0] + 7, here[1] - 9
    assert found.cost[here] - found.cost[elsewhere] == pytest.approx(cost(here) - cost(elsewhere), rel=2e-2)


def test_a_map_needs_a_motion() -> None:
    rows = ChannelRows(walk(), np.ones(30_000), 1e-3)
    with pytest.raises(UsageError, match="passes unchanged"):
        cost_map(rows, ChannelRecipe(name="ax", model="constant"))


def test_a_lag_that_no_page_can_wait_for_is_refused(desk: ViewModel, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = len(desk.opened.recording)
    monkeypatch.setattr("becalm.web.tuner.view_model._MOST_WAITED", 30 * rows)
    desk.set_mode("lagged", 30 * desk.opened.step_s)
    with pytest.raises(UsageError, match=r"give at most 0\.06 s.*becalm clean FILE -o OUT --lag 0\.062s"):
        desk.set_mode("lagged", 31 * desk.opened.step_s)
    longer = desk.recipe().to_toml().replace("lag_s = 0.06", "lag_s = 0.5")
    with pytest.raises(UsageError, match="too long to be drawn"):
        desk.restore(longer)
    assert desk.now.lag_s == pytest.approx(0.06)
