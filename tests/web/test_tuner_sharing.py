"""What pages have in common: nobody waits for another, and what is overtaken is not told."""

from __future__ import annotations

import asyncio
import gc
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.websockets import WebSocketDisconnect

from becalm.errors import InputError
from becalm.web.frames import frame
from becalm.web.tuner import picture_sender, sharing
from becalm.web.tuner.messages import Map
from becalm.web.tuner.painting import PictureRequest
from becalm.web.tuner.sharing import Shared
from becalm.web.tuner.tuner_session import TunerSession
from becalm.web.tuner.view_model import ViewModel
from served import PATIENCE_S, until
from tuner_served import drive_in, served


class Ear:
    """A page that hears, or is told something without end."""

    def __init__(self, *, deaf: bool = False) -> None:
        self.heard: list[str] = []
        self.deaf = deaf

    async def send_text(self, text: str) -> None:
        if self.deaf:
            await asyncio.Event().wait()
        self.heard.append(text)


class Leaving(Ear):
    """A page that goes after it was welcomed, which is noticed where it is told something first."""

    def __init__(self) -> None:
        super().__init__()
        self.gone = asyncio.Event()

    async def accept(self) -> None: ...

    async def send_text(self, text: str) -> None:
        if self.heard:
            self.gone.set()
            raise WebSocketDisconnect
        await super().send_text(text)

    async def receive(self) -> dict[str, str]:
        await self.gone.wait()
        await asyncio.sleep(0)  # later than who told it
        return {"type": "websocket.disconnect"}


def complaints() -> list[str]:
    """Return what asyncio says of tasks that failed, and that nobody looked at."""
    said: list[str] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: said.append(context["message"]))
    return said


def test_nobody_waits_for_a_page_that_does_not_listen(tmp_path: Path) -> None:
    async def tell() -> list[int]:
        shared = Shared(tmp_path, None, 1)
        ears = [Ear(deaf=True), Ear(), Ear()]
        pages: list[Any] = [TunerSession(shared, ear) for ear in ears]  # type: ignore[arg-type]
        shared.pages.update(pages)
        try:
            await asyncio.wait_for(shared.broadcast(lambda page: page.send_progress("..."), pages[1]), PATIENCE_S)
            while not ears[2].heard:
                await asyncio.sleep(0)
            return [len(ear.heard) for ear in ears]
        finally:
            shared.close()

    assert asyncio.run(tell()) == [0, 1, 1]


def test_an_opening_goes_on_when_the_page_that_asked_is_reloaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def read(*_: object) -> object:
        begun.set()
        assert go_on.wait(PATIENCE_S)
        return SimpleNamespace(begin=lambda: None)

    monkeypatch.setattr(sharing, "OpenRecording", read)
    monkeypatch.setattr(sharing, "ViewModel", lambda opened: opened)
    drive_in(tmp_path)

    async def reload() -> object:
        shared = Shared(tmp_path, None, 1)
        try:
            asked = asyncio.create_task(shared.open("folder/drive.csv", None))
            await asyncio.to_thread(begun.wait, PATIENCE_S)
            asked.cancel()
            await asyncio.gather(asked, return_exceptions=True)
            go_on.set()
            await asyncio.wait_for(asyncio.gather(*shared._openings), PATIENCE_S)
            return shared.view_model
        finally:
            shared.close()

    assert asyncio.run(reload()) is not None


def test_a_page_that_goes_is_no_failure(tmp_path: Path) -> None:
    async def leave() -> list[str]:
        said, shared, leaving = complaints(), Shared(tmp_path, tmp_path / "nowhere.csv", 1), Leaving()
        try:
            await asyncio.wait_for(TunerSession(shared, leaving).run(), PATIENCE_S)  # type: ignore[arg-type]
        finally:
            shared.close()
        gc.collect()
        return said

    assert asyncio.run(leave()) == []


def test_an_opening_that_fails_when_its_page_is_gone_is_no_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def read(*_: object) -> object:
        begun.set()
        assert go_on.wait(PATIENCE_S)
        raise InputError("drive.csv is broken.")

    monkeypatch.setattr(sharing, "OpenRecording", read)
    drive_in(tmp_path)

    async def reload() -> list[str]:
        said, shared = complaints(), Shared(tmp_path, None, 1)
        try:
            asked = asyncio.create_task(shared.open("folder/drive.csv", None))
            await asyncio.to_thread(begun.wait, PATIENCE_S)
            asked.cancel()
            await asyncio.gather(asked, return_exceptions=True)
            go_on.set()
            while shared._openings:
                await asyncio.sleep(0)
        finally:
            shared.close()
        gc.collect()
        return said

    assert asyncio.run(reload()) == []


def test_of_two_maps_only_the_newer_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawing, go_on = threading.Event(), threading.Event()

    def draw(wanted: PictureRequest) -> bytes:
        if not drawing.is_set():
            drawing.set()
            assert go_on.wait(PATIENCE_S)
        return frame({"kind": "map", "answers": wanted.answers}, {})

    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.talk() as page:
        page.opened("folder/drive.csv")
        monkeypatch.setattr(picture_sender, "map_frame", draw)
        page.ask("map", channel=0)
        assert drawing.wait(PATIENCE_S)
        newer = page.ask("map", channel=0)
        assert page.until("map").told["answers"] == newer
        go_on.set()
        last = page.ask("map", channel=0)
        assert page.until("map").told["answers"] == last


def test_a_map_that_is_overtaken_before_it_is_begun_leaves_nothing(tmp_path: Path) -> None:
    async def ask() -> list[str]:
        shared, ear = Shared(tmp_path, None, 1), Ear()
        page = TunerSession(shared, ear)  # type: ignore[arg-type]
        try:
            for number in (1, 2):
                await page._do(Map(number=number, do="map", channel=0))
            while not ear.heard:
                await asyncio.sleep(0.01)
            return ear.heard
        finally:
            shared.close()

    (said,) = asyncio.run(ask())
    assert "Nothing is open yet" in said


def test_a_page_that_is_closed_while_it_is_answered_leaves_nothing_in_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def set_mode(*_: object) -> None:
        begun.set()
        assert go_on.wait(PATIENCE_S)

    monkeypatch.setattr(ViewModel, "set_mode", set_mode)
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.talk() as other:
        with tuner.talk() as page:
            page.opened("folder/drive.csv")
            page.ask("mode", mode="causal")
            assert begun.wait(PATIENCE_S)
        other.picture(other.ask("turn", channel=0, settings={"noise_std": 0.5}))  # of which the closed one is told too
        go_on.set()
        until(lambda: len(tuner.tuner._shared.pages) == 1)
    assert caplog.text == ""


def test_figures_tell_of_which_setting_they_are_though_another_one_makes_the_same_filter(tmp_path: Path) -> None:
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.talk() as page:
        page.opened("folder/drive.csv")
        for lag_s in (0.1, 0.1004):  # as many rows
            page.ask("mode", mode="lagged", lag_s=lag_s)
            while (figures := page.until("figures").told)["of"][1] != lag_s:
                pass
            state = next(heard.told for heard in reversed(page.heard) if heard.kind == "state")
            assert figures["of"] == ["lagged", lag_s, state["channels"][0]]
