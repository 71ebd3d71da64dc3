"""The live page's wire: all who look on get every bin, at their own pace, and hold up nobody."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from becalm.cleaning.recipes.recipe import Recipe
from becalm.web.access import LOOPBACK
from becalm.web.livepage import page
from live_shown import EACH, NAMES, PATIENCE_S, TOKEN, Shown, recipe_of, shown
from served import until


@pytest.fixture
def live() -> Iterator[Shown]:
    with shown() as served:
        yield served


def test_a_page_is_told_what_comes_from_the_first_row_on(live: Shown) -> None:
    with live.wire() as wire:
        assert wire.hear("health")[0]["state"] == "starting"
        live.meter.state("learning")
        assert wire.hear("health", state="learning")[0]["channels"] == {}
        live.begin()
        welcome, _ = wire.hear("welcome")
        assert (welcome["names"], welcome["units"], welcome["rate_hz"]) == (list(NAMES), ["m", "deg"], 1500.0)
        assert welcome["rows_each"] == [10, 80, 640, 5120, 40960]
        assert welcome["modes"] == {"1": ["still", "moving"]}
        wire.say(do="from", level=0, bin=None)
        tuned, _ = wire.hear("tuned")
        assert [one["order"] for one in tuned["filters"]] == [2, 2]
        assert list(tuned["dials"]) == ["0"], "what switches has none"
        assert tuned["dials"]["0"]["at"] == 1.0
        for _ in range(20):
            live.push(37)
        assert not any(gap for _, _, gap in wire.bins(20 * 37 // EACH))


def test_two_pages_see_the_same_bins_each_once(live: Shown) -> None:
    live.begin()
    with live.wire() as one, live.wire() as two:
        one.follow()
        two.follow()
        for _ in range(100):
            live.push(97)
        for wire in (one, two):
            nextbin = 0
            for first, count, gap in wire.bins(9700 // EACH):
                assert (first, gap) == (nextbin, 0)
                nextbin += count


def test_a_page_goes_on_where_it_was_and_looks_back(live: Shown) -> None:
    live.begin()
    live.push(6400)
    with live.wire() as wire:
        wire.follow(bin=300)
        assert wire.bins(640)[0][0] == 300
    with live.wire() as wire:
        wire.follow(bin=3, level=1)
        assert wire.bins(80) == [(3, 77, 0)]
        number = wire.say(do="past", level=0, first=10, count=20)
        header, arrays = wire.hear("bins", answers=number)
        assert (header["first"], header["count"]) == (10, 20)
        assert arrays["verdicts"].size == 40
        number = wire.say(do="past", level=0, first=100_000, count=20)
        assert wire.hear("bins", answers=number)[0]["count"] == 0


def test_what_has_left_is_told_as_a_gap(live: Shown) -> None:
    live.begin()
    live.push(100_000)
    with live.wire() as wire:
        wire.follow(bin=0)
        found = wire.bins(100_000 // EACH)
        left = 100_000 // EACH - live.page.feed.stream.bins.kept if live.page.feed.stream else 0
        assert found[0] == (left, 4096, left)
        assert left > 0
        assert not any(gap for _, _, gap in found[1:])


def test_a_page_that_asks_without_end_is_heard_as_answers_come(live: Shown) -> None:
    live.begin()
    with live.wire() as wire, live.wire() as other:
        other.follow()
        for _ in range(100):
            wire.say(do="turn", channel=0, process_noise_density=2.0)
        until(lambda: len(live.asked.waiting) == 16)
        live.push(1000)
        assert other.bins(1000 // EACH)[-1][2] == 0
        wire.hear("health")
        wire.hear("health")
        assert len(live.asked.waiting) == 16
        live.asked.take()
        wire.hear("taken")


def test_a_page_that_does_not_listen_holds_up_nobody(live: Shown) -> None:
    live.begin()
    deaf_socket = socket.socket()
    deaf_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf_socket.connect((LOOPBACK, live.access.port))
    with live.wire(deaf_socket) as deaf, live.wire() as quick:
        deaf.follow()
        quick.follow()
        told = 0
        while told < 60_000:  # more bins than are held, and than fit into the pipe
            live.push(20_000)
            told = live.rows // EACH
            assert all(gap == 0 for _, _, gap in quick.bins(told))
        found = deaf.bins(told)
        assert found[0][0] == 0
        assert sum(gap for _, _, gap in found) > 0, "it missed some, and is told how many"
        assert sum(count + gap for _, count, gap in found) == told


@pytest.mark.parametrize(
    "message",
    [
        {"do": "from"},
        {"do": "from", "level": 5, "bin": 0},
        {"do": "from", "level": True, "bin": 0},
        {"do": "from", "level": 0, "bin": -1},
        {"do": "past", "level": 0, "first": 0, "count": 1 << 30},
        {"do": "turn", "channel": 0, "process_noise_density": -1.0},
        {"do": "turn", "channel": 0, "process_noise_density": "1"},
        {"do": "turn", "channel": 0, "recipe": ""},
        {"do": "turn", "channel": 7, "process_noise_density": 1.0},
        {"do": "turn", "channel": 1, "process_noise_density": 1.0},
        {"do": "undo"},
        {"do": "sudo"},
        {},
    ],
)
def test_what_no_page_asks_is_refused_and_the_wire_stays_open(live: Shown, message: dict[str, Any]) -> None:
    live.begin()
    with live.wire() as wire:
        wire.follow()
        number = wire.say(**message)
        says = wire.hear("trouble", answers=number)[0]["says"]
        assert says.endswith(".")
        live.push(100)
        wire.bins(10)
    assert live.asked.waiting == []


def test_frames_that_are_no_messages_are_refused(live: Shown) -> None:
    with live.wire() as wire:
        for sent in (b"\0\1", "{", "[]", '{"do": NaN}'):
            wire.link.send(sent)
            wire.hear("trouble", answers=None)


def test_a_dial_is_turned_and_undone_and_all_hear_of_it(live: Shown) -> None:
    live.begin()
    with live.wire() as one, live.wire() as two:
        for wire in (one, two):
            wire.hear("tuned", can_undo=False)
        number = one.say(do="turn", channel=0, process_noise_density=2.5)
        until(lambda: bool(live.asked.waiting))
        taken = live.asked.take()
        assert taken.channel[0].process_noise_density == 2.5
        assert taken.channel[1] == recipe_of().channel[1]
        one.hear("taken", answers=number)
        for wire in (one, two):
            tuned = wire.hear("tuned", can_undo=True)[0]
            assert tuned["dials"]["0"]["at"] == 2.5
            assert Recipe.from_toml(tuned["recipe"]) == taken
        two.say(do="undo")
        until(lambda: bool(live.asked.waiting))
        assert live.asked.take() == recipe_of()
        one.hear("tuned", can_undo=False)


def test_a_turn_that_is_refused_is_told_to_who_made_it(live: Shown) -> None:
    live.begin()
    with live.wire() as wire:
        number = wire.say(do="turn", channel=0, process_noise_density=2.5)
        until(lambda: bool(live.asked.waiting))
        live.asked.take("This cannot be.")
        assert wire.hear("trouble", answers=number)[0]["says"] == "This cannot be."
        assert not live.page.dial.can_undo


def test_turns_that_wait_are_not_lost_by_later_ones(live: Shown) -> None:
    live.begin()
    with live.wire() as wire:
        first = wire.say(do="turn", channel=0, process_noise_density=2.5)
        wire.say(do="turn", channel=0, noise_std=0.125)
        until(lambda: len(live.asked.waiting) == 2)
        both = live.asked.take().channel[0]
        assert (both.process_noise_density, both.noise_std) == (2.5, 0.125)
        wire.hear("passed over", answers=first)


def test_no_secret_is_told(live: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BROKER_PASSWORD", "hunter2 and more")
    with shown() as other:
        other.begin()
        other.meter.state("away", "mqtt://me:geheim@host says hunter2 and more")
        with other.wire() as wire:
            health = json.dumps(wire.hear("health", state="away")[0])
            assert "***" in health
            assert "geheim" not in health
            assert "hunter2" not in health


def test_an_end_is_told_with_the_last_rows(live: Shown) -> None:
    live.begin()
    with live.wire() as wire:
        wire.follow()
        live.push(103)
        wire.bins(10)
        live.page.feed.close()
        live.meter.state("ended")
        live.page.close()
        rest = wire.rest()
        assert wire.link.close_code == 1000
        last, arrays = next((header, arrays) for header, arrays in rest if header["kind"] == "bins")
        assert (last["first"], last["count"]) == (10, 1)
        assert arrays["raw_high"][0] + last["offset"][0] == 102
        assert [header["state"] for header, _ in rest if header["kind"] == "health"][-1] == "ended"


def test_what_fails_once_is_logged_and_health_goes_on(
    live: Shown, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object) -> dict[str, Any]:
        raise ZeroDivisionError("by nothing")

    live.begin()
    with live.wire() as wire:
        wire.hear("tuned", can_undo=False)
        with monkeypatch.context() as patched:
            patched.setattr(page, "describe_filters", broken)
            live.meter.set_recipe(recipe_of(3.0).to_toml())
            assert "dials" not in wire.hear("tuned")[0], "what is known is told all the same"
        with monkeypatch.context() as patched:
            patched.setattr(live.meter, "status", broken)
            until(lambda: "could not be updated" in caplog.text)
        live.meter.state("silent")
        wire.hear("health", state="silent")
        live.meter.set_recipe(recipe_of(4.0).to_toml())
        assert wire.hear("tuned")[0]["dials"]["0"]["at"] == 4.0
    assert caplog.text.count("by nothing") >= 2


def test_the_recipe_of_now_is_saved(live: Shown) -> None:
    base, cookie = f"http://{LOOPBACK}:{live.access.port}", {"cookie": f"{live.access.cookie}={TOKEN}"}
    with httpx.Client(base_url=base, trust_env=False, timeout=PATIENCE_S) as browser:
        assert browser.get("/save/recipe").status_code == 403
        early = browser.get("/save/recipe", headers=cookie)
        live.begin()
        answer = browser.get("/save/recipe", headers=cookie)
    assert (early.status_code, early.text) == (400, "The stream has not begun yet.")
    assert answer.headers["content-disposition"] == "attachment; filename*=UTF-8''live.recipe.toml"
    assert Recipe.from_toml(answer.text) == recipe_of()
