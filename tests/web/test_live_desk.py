"""The live dial's desk: turns and undos in flight, passed over, refused, and taken back one by one."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import UsageError
from becalm.live.watching.meter import Meter
from becalm.web.livepage import live_dial as desks
from becalm.web.livepage.live_dial import LiveDial
from live_shown import NAMES, Asked, recipe_of


class Turned:
    """A desk, and a runner of a stream that has begun."""

    def __init__(self) -> None:
        self.meter = Meter("replay:drive.csv")
        self.meter.begin(NAMES, recipe_of().to_toml())
        self.asked = Asked(self.meter)
        self.desk = LiveDial(lambda: self.meter.recipe, self.asked.retune)
        self.heard: list[str | None] = []

    def turn(self, density: float) -> None:
        self.desk.turn(0, density, None, self.heard.append)

    def undo(self) -> None:
        self.desk.undo(self.heard.append)

    @property
    def density(self) -> float | None:
        return Recipe.from_toml(self.meter.recipe).channel[0].process_noise_density

    def all_undone(self) -> list[float | None]:
        """Take turn after turn back; return where the dial was after each."""
        found = []
        while self.desk.can_undo:
            self.undo()
            self.asked.take()
            found.append(self.density)
        return found


def test_two_turns_in_flight_are_taken_back_one_by_one() -> None:
    turned = Turned()
    turned.turn(2.0)
    turned.asked.begin()
    turned.turn(3.0)
    turned.asked.take()
    turned.asked.take()
    assert turned.density == 3.0
    assert turned.all_undone() == [2.0, 1.0]


def test_a_turn_that_is_passed_over_is_in_the_next_and_is_taken_back_alone() -> None:
    turned = Turned()
    turned.turn(2.0)
    turned.turn(3.0)
    turned.asked.take()
    assert turned.heard == [None, ""]
    assert turned.all_undone() == [2.0, 1.0]


@pytest.mark.parametrize("begun", [False, True])
def test_two_quick_undos_take_two_turns_back(begun: bool) -> None:
    turned = Turned()
    for density in (2.0, 3.0, 4.0):
        turned.turn(density)
        turned.asked.take()
    turned.undo()
    if begun:
        turned.asked.begin()
    turned.undo()
    turned.asked.take()
    if begun:
        turned.asked.take()
    assert turned.density == 2.0
    assert turned.all_undone() == [1.0]


@pytest.mark.parametrize("begun", [False, True])
def test_a_turn_that_is_made_is_taken_back_and_forgotten(begun: bool) -> None:
    turned = Turned()
    turned.turn(2.0)
    if begun:
        turned.asked.begin()
    turned.undo()
    turned.asked.take()
    if begun:
        turned.asked.take()
    assert turned.density == 1.0
    assert not turned.desk.can_undo
    with pytest.raises(UsageError, match="nothing to undo"):
        turned.undo()


@pytest.mark.parametrize("passed", [lambda asked: asked.take(), lambda asked: asked.take("This cannot be.")])
def test_a_turn_that_another_recipe_passed_over_is_forgotten(passed: Callable[[Asked], object]) -> None:
    """As when a recipe is read again from its file: what is turned next begins from what rows go through."""
    turned = Turned()
    turned.turn(2.0)
    turned.asked.retune(lambda: recipe_of(7.0), turned.heard.append)
    passed(turned.asked)
    before = turned.density
    assert turned.heard[0] is None
    assert not turned.desk.can_undo
    turned.desk.turn(0, None, 0.125, turned.heard.append)
    taken = turned.asked.take().channel[0]
    assert (taken.process_noise_density, taken.noise_std) == (before, 0.125)
    assert turned.all_undone() == [before]


def test_a_turn_begins_from_a_recipe_that_was_taken_after_it_was_asked_for() -> None:
    turned = Turned()
    turned.asked.retune(lambda: recipe_of(7.0), turned.heard.append)
    turned.asked.begin()
    turned.desk.turn(0, None, 0.125, turned.heard.append)
    turned.asked.take()
    taken = turned.asked.take().channel[0]
    assert (taken.process_noise_density, taken.noise_std) == (7.0, 0.125)
    assert turned.all_undone() == [7.0]


def test_a_turn_that_is_refused_takes_none_with_it() -> None:
    turned = Turned()
    turned.turn(2.0)
    turned.asked.begin()
    turned.desk.turn(0, None, 0.125, turned.heard.append)
    turned.asked.take("This cannot be.")
    taken = turned.asked.take().channel[0]
    assert (taken.process_noise_density, taken.noise_std) == (1.0, 0.125)
    assert turned.heard == ["This cannot be.", ""]
    assert turned.all_undone() == [1.0]


def test_only_so_many_turns_are_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desks, "_REMEMBERED", 3)
    turned = Turned()
    for density in range(2, 9):
        turned.turn(density)
        turned.asked.take()
    assert turned.all_undone() == [7.0, 6.0, 5.0]


@pytest.mark.parametrize(
    ("channel", "says"),
    [
        (1, f"Channel {NAMES[1]} has no dial: its filter has several modes."),
        (2, "There is no channel 3; the stream has 2. Reload the page."),
    ],
)
def test_what_has_no_dial_is_said_by_name(channel: int, says: str) -> None:
    turned = Turned()
    with pytest.raises(UsageError) as refused:
        turned.desk.turn(channel, 2.0, None, turned.heard.append)
    assert str(refused.value) == says
    assert turned.asked.waiting == []


def test_a_turn_before_the_stream_began_is_refused() -> None:
    turned = Turned()
    turned.meter.set_recipe("")
    with pytest.raises(UsageError, match=r"^The stream has not begun yet\.$"):
        turned.turn(2.0)


def test_a_turn_to_nothing_is_refused_and_cannot_be_taken_back() -> None:
    turned = Turned()
    with pytest.raises(UsageError, match=r"did not send a value"):
        turned.desk.turn(0, None, None, turned.heard.append)
    assert not turned.asked.waiting
