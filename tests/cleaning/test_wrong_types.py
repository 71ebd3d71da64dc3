"""What a person hands over by mistake is refused with a sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import becalm
from becalm.cleaning.pipeline import in_mode
from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.filter.gate import Gate, threshold_for
from becalm.core.imm.modes import InteractingModels
from becalm.core.steady.response import describe
from becalm.errors import BecalmError
from becalm.identification.at_rest.allan import allan_deviation
from becalm.identification.wishes.dial import Dial
from becalm.identification.wishes.gain_of_waiting import waiting_curve
from becalm.identification.wishes.noise_against_lag import trade_off_curve


def wishes(**given: Any) -> Callable[..., Any]:
    return lambda: becalm.tune(ROWS, wishes=becalm.Wishes(**given))


MODEL = becalm.components.motion(2, noise_density=1e-3).to_model(step_s=0.01, noise_variance=0.09)
RECIPE = Recipe(tuned_on=Origin(rate_hz=100.0), channel=(ChannelRecipe(name="a", model="untold"),))
ROWS = becalm.Recording(np.random.default_rng(0).normal(size=200), rate_hz=100.0)
MISTAKES: dict[str, tuple[Callable[..., Any], str]] = {
    "a lag with its unit": (lambda: becalm.clean(ROWS, lag_s="10ms"), "lag_s = '10ms' is not a number; give seconds"),  # type: ignore[arg-type]
    "a recipe's file": (lambda: becalm.clean(ROWS, "a.toml"), "A Recipe is needed; 'a.toml' came. Load one"),  # type: ignore[arg-type]
    "a number for wishes": (lambda: becalm.tune(ROWS, wishes=3), "Wishes are needed; 3 came. Make some"),  # type: ignore[arg-type]
    "a list for a recording": (lambda: becalm.clean([1, 2]), "A Recording is needed; list came"),  # type: ignore[arg-type]
    "a threshold as text": (lambda: Gate("5"), "threshold = '5' is not a threshold"),  # type: ignore[arg-type]
    "half a reject": (lambda: Gate(5.0, 2.5), "agree = 2.5 and at_most = "),  # type: ignore[arg-type]
    "a lag that is True": (lambda: becalm.clean(ROWS, lag_s=True), "lag_s = True is not a number"),
    "a lag before now": (lambda: in_mode(RECIPE, lag_s=-1.0), "lag_s = -1 is not a lag; give seconds above 0"),
    "a lag that is NaN": (lambda: in_mode(RECIPE, lag_s=np.nan), "lag_s = nan is not a lag"),
    "a lag beyond float64": (lambda: in_mode(RECIPE, lag_s=10**400), "lag_s = 10+ is not a number"),
    "causal in words": (lambda: becalm.clean(ROWS, causal="no"), "causal = 'no' came; give causal=True"),  # type: ignore[arg-type]
    "causal in words to tune": (lambda: becalm.tune(ROWS, causal="no"), "causal = 'no' came"),  # type: ignore[arg-type]
    "a number for channels": (lambda: becalm.clean(ROWS, channels=5), "channels = 5 is no list of names"),  # type: ignore[arg-type]
    "a negative uncertainty of times": (wishes(time_std_s=-1), "time_std_s = -1 is not an uncertainty of times"),
    "an uncertainty of times that is NaN": (wishes(time_std_s=np.nan), "time_std_s = nan is not"),
    "an uncertainty of times as text": (wishes(time_std_s="1"), "time_std_s = '1' is not"),
    "an uncertainty of times beyond all": (wishes(time_std_s=1e300), r"time_std_s = 1e\+300 is longer than the record"),
    "one frequency to remove": (wishes(removed_hz=10.0), "removed_hz = 10.0 is not a tuple of frequencies"),
    "a frequency as text": (wishes(removed_hz=("10",)), r"removed_hz = \('10',\) is not a tuple"),
    "one stretch at rest": (wishes(still_s=(0, 1)), r"still_s = \(0, 1\) is not a tuple of stretches"),
    "three ends of a rest": (wishes(still_s=((0, 1, 2),)), "still_s = .* is not a tuple of stretches"),
    "a rest as text": (wishes(still_s=(("0", "1"),)), "still_s = .* is not a tuple of stretches"),
    "a number for a dial": (wishes(dial=5), "dial = 5 is not a Dial; give one"),
    "a dial as text": (wishes(dial=Dial("bandwidth_hz", "5")), "dial = Dial.* is not a Dial"),  # type: ignore[arg-type]
    "an unknown dial": (wishes(dial=Dial("lag", 0.05)), "'lag' is not a dial; give one of 'max_lag_s'"),  # type: ignore[arg-type]
    "a number for a rest": (wishes(rest=5, still_s=((0, 1),)), "A Recording is needed; int came"),
    "a path that is none": (lambda: becalm.Recipe.load(5), "The recipe 5 cannot be read: it is not a path"),  # type: ignore[arg-type]
    "a number for names": (lambda: becalm.Recording([1.0], rate_hz=1, names=5), "names = 5 is not a list of texts"),  # type: ignore[arg-type]
    "a number for units": (lambda: becalm.Recording([1.0], rate_hz=1, units=5), "units = 5 is not a list of texts"),  # type: ignore[arg-type]
    "a rate that is True": (lambda: becalm.Recording([1.0], rate_hz=True), "rate_hz = True is not a rate"),
    "a rate beyond float64": (lambda: becalm.Recording([1.0], rate_hz=10**400), "rate_hz = 10+ is not a rate"),
    "times beyond float64": (lambda: becalm.Recording([1.0], times_s=[10**400]), "times_s is not an array of numbers"),
    "a stream without a recipe": (lambda: StreamCleaner(5, 0.01), "A Recipe is needed; 5 came"),  # type: ignore[arg-type]
    "a stream without a step": (lambda: StreamCleaner(RECIPE, 0.0), "step_s = 0.0 is not a step"),
    "a stream's step as text": (lambda: StreamCleaner(RECIPE, "a"), "step_s = 'a' is not a step"),  # type: ignore[arg-type]
    "no snapshot": (lambda: StreamCleaner.resume(None, RECIPE), "These bytes are not a snapshot.*: NoneType came"),  # type: ignore[arg-type]
    "a rate of alarms as text": (lambda: threshold_for("a", 1), "false_alarms_per_hour = 'a' is not a rate"),  # type: ignore[arg-type]
    "a threshold beyond float64": (lambda: Gate(10**400), "threshold = 10+ is not a threshold"),
    "a number for a mode": (lambda: InteractingModels((5,)), r"modes = \(5,\) is not a tuple of modes"),  # type: ignore[arg-type]
    "a number for a component": (lambda: becalm.components.motion(2) + 5, "5 is not a Component; add one"),  # type: ignore[operator]
    "an uneven variance": (
        lambda: becalm.components.motion(2).to_model(0.01, [0.09]),  # type: ignore[arg-type]
        r"noise_variance = \[0.09\] is not a variance",
    ),
    "a number for a model": (lambda: describe(5, 0.1), "A Model is needed; int came"),  # type: ignore[arg-type]
    "an output as text": (lambda: describe(MODEL, 0.1, output=["a", "b"]), "output is not a row of numbers"),
    "an Allan rate as text": (lambda: allan_deviation([1.0, 2.0], "100"), "rate_hz = '100' is not a rate"),  # type: ignore[arg-type]
    "a confidence as text": (lambda: allan_deviation([1.0], 1.0, confidence="a"), "confidence = 'a' is not between"),  # type: ignore[arg-type]
    "readings beyond float64": (lambda: allan_deviation([10**400] * 3, 1.0), "readings are not numbers"),
    "half a reading's wait": (
        lambda: waiting_curve(2, 0.1, 1.0, 0.01, [1.5]),  # type: ignore[list-item]
        r"waits = \[1.5\] contains a part of a reading",
    ),
    "readings too small to square": (
        lambda: becalm.clean(ROWS.with_samples(1e-160 * ROWS.samples)),
        "channel_0: the readings differ by .* give another unit",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_said(name: str) -> None:
    make, says = MISTAKES[name]
    with pytest.raises(BecalmError, match=f"^{says}"):
        make()


def test_numbers_of_numpy_are_numbers() -> None:
    given: tuple[Any, ...] = (np.float32(0.5), np.int64(1))
    for lag_s in given:
        assert f"lag_s = {float(lag_s)}" in in_mode(RECIPE, lag_s=float(lag_s)).to_toml()
        assert in_mode(RECIPE, lag_s=lag_s).to_toml() == in_mode(RECIPE, lag_s=float(lag_s)).to_toml()
    same = becalm.components.motion(2, noise_density=1e-3).to_model(0.01, np.asarray(0.09))  # type: ignore[arg-type]
    np.testing.assert_array_equal(same.R, MODEL.R)
    assert len(trade_off_curve(1.0, 0.01, (1,), np.array([0.1, 0.2])).points) == 2  # type: ignore[arg-type]
    assert len(waiting_curve(2, 0.1, 1.0, 0.01, np.array([0, 3]))) == 3  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "table",
    [
        "coloured_noise = {rate_hz = 100.0, coefficients = [0.5], std = 1e200}",
        "calibration = {relative_std = 1e160}",
        "calibration = {offset_std = 1e160}",
        "limits = {rounding_std = 1e300}",
        "timing = {std_s = 1e300}",
    ],
)
def test_an_uncertainty_whose_square_overflows_is_refused(table: str) -> None:
    with pytest.raises(BecalmError, match=r"is too large; give 1e.100 or less"):
        Recipe.from_toml(f"{RECIPE.to_toml()}{table}\n")


def test_a_table_is_written_of_a_recording(tmp_path: Path) -> None:
    with pytest.raises(BecalmError, match="A Recording is needed; ndarray came: write"):
        becalm.write(tmp_path / "a.csv", np.ones(3))  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
