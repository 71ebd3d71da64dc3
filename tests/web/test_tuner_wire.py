"""A page and the tuner in conversation, over a real WebSocket."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import nptdms as tdms
import numpy as np
import pytest

import becalm
from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.reading_verdicts import Verdict
from becalm.web.tuner import picture_sender
from tuner_served import ROWS, Served, Talk, drive_in, served


@pytest.fixture(scope="module")
def tuner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("folder")
    drive_in(folder)
    with served(folder) as found:
        yield found


@pytest.fixture
def page(tuner: Served) -> Iterator[Talk]:
    with tuner.talk() as talk:
        assert talk.hear().kind == "welcome"
        if talk.heard[-1].told["file"] is None:
            talk.opened("folder/drive.csv")
        else:
            talk.until("picture")
        talk.ask("turn", channel=0, settings={"choice": "found", "on": {"gate": True}})
        talk.until("state")
        yield talk


def test_opening_tells_all_that_a_page_needs(tmp_path: Path) -> None:
    drive_in(tmp_path)
    with served(tmp_path) as tuner, tuner.talk() as page:
        welcome = page.hear().told
        assert (welcome["kind"], welcome["folder"], welcome["file"]) == ("welcome", tmp_path.name, None)
        assert [one["name"] for one in welcome["files"]] == ["drive.csv"]
        recording = page.opened(welcome["files"][0]["id"])
        kinds = [heard.kind for heard in page.heard]
        assert kinds.index("working") < kinds.index("recording") < kinds.index("picture")
        page.until("figures") if "figures" not in kinds else None
        assert (recording["name"], recording["rows"], recording["mode"]) == ("drive.csv", ROWS, "smoothed")
        channel = recording["channels"][0]
        assert (channel["name"], channel["unit"]) == ("ax", "")
        assert [one["key"] for one in channel["choices"]][:2] == ["found", "order-1"]
        assert all("reading" in one["evidence"] for one in channel["choices"][1:])
        assert {"gate", "tone-0"} <= {one["key"] for one in channel["components"]}
        assert recording["command"] == "becalm clean drive.csv -o drive-clean.csv --recipe drive.recipe.toml"
        figures = page.heard[-1].told
        assert figures["tone"] in ("fits", "except", "not")
        drawn = {figure["name"]: figures["captions"][figure["name"]] for figure in figures["payload"]["figures"]}
        assert {f"1-ax-{name}" for name in ("whiteness", "nis", "step", "spectrum")} <= set(drawn)
        assert all(drawn[f"1-ax-{name}"].endswith(".") for name in ("whiteness", "nis", "spectrum"))
        dial = next(heard for heard in page.heard if heard.kind == "dial").arrays
        assert (np.diff(dial["noise_left"]) < 0).all()
        assert (np.diff(dial["process_noise_density"]) < 0).all()


def test_a_picture_is_what_clean_gives(page: Talk, tuner: Served) -> None:
    number = page.ask("look", channel=0, from_s=2.9, to_s=3.1, width=4000)
    found = page.picture(number)
    page.ask("turn", channel=0, settings={}, final=True)
    recipe = Recipe.from_toml(page.until("state").told["recipe"])
    cleaned = becalm.clean(becalm.read(tuner.folder / "drive.csv"), recipe)
    first = round(found.arrays["t"][0] * 500)
    rows = slice(first, first + len(found.arrays["t"]))
    assert found.told["rows_each"] == 1
    signal, sigma = cleaned.signal.samples[rows, 0], cleaned.sigma.samples[rows, 0]
    np.testing.assert_allclose(found.arrays["clean_low"], signal, atol=1e-6)
    np.testing.assert_allclose(found.arrays["band_high"], signal + 2 * sigma, atol=1e-6)
    outliers = found.arrays["verdicts"] == 1 << Verdict.OUTLIER
    np.testing.assert_array_equal(found.arrays["t"][outliers], [3.0])
    assert np.isnan(found.arrays["raw_high"][outliers]).all()  # what no sensor gives is not drawn


def test_a_dial_is_turned_and_turned_back(page: Talk) -> None:
    before = page.picture(page.ask("look", channel=0, width=500))
    number = page.ask("turn", channel=0, settings={"process_noise_density": 1e-3}, final=False)
    calmer = page.picture(number)
    assert calmer.told["filter"]["noise_left"] < before.told["filter"]["noise_left"]
    assert np.abs(calmer.arrays["clean_high"] - before.arrays["clean_high"]).max() > 0.1
    page.ask("turn", channel=0, settings={"process_noise_density": 2e-3})
    state = page.until("state").told
    assert state["can_undo"]
    assert state["changed"]
    assert state["channels"][0]["process_noise_density"] == 2e-3
    assert Recipe.from_toml(state["recipe"]).channel[0].tuning_spread == 0.0
    number = page.ask("undo")
    state = page.until("state").told
    assert state["can_redo"]
    np.testing.assert_array_equal(page.picture(number).arrays["clean_high"], before.arrays["clean_high"])
    page.ask("redo")
    assert page.until("state").told["channels"][0]["process_noise_density"] == 2e-3
    page.ask("undo")
    page.until("state")


def test_the_newest_turn_wins(page: Talk) -> None:
    page.picture(page.ask("look", channel=1, width=300))
    densities = np.geomspace(1e-6, 1.0, 60)
    for density in densities:
        last = page.ask("turn", channel=1, settings={"process_noise_density": float(density)}, final=False)
    shown = [page.until("picture")]
    while shown[-1].told["answers"] < last:
        shown.append(page.until("picture"))
    answers = [one.told["answers"] for one in shown]
    assert answers == sorted(answers)
    assert len(shown) < len(densities)
    page.ask("turn", channel=1, settings={"process_noise_density": float(densities[-1])})
    assert page.until("state").told["channels"][1]["process_noise_density"] == densities[-1]
    page.ask("undo")
    page.until("state")


@pytest.mark.parametrize(
    "sent",
    [
        "nonsense",
        "[]",
        '{"number": 1, "do": "fly"}',
        '{"number": 1, "do": "look", "channel": 0, "width": 0}',
        '{"number": 1, "do": "look", "channel": -1, "width": 10}',
        '{"number": 1, "do": "look", "channel": 99, "width": 10}',
        '{"number": 1, "do": "look", "channel": 0, "width": 10, "more": 1}',
        '{"number": 1, "do": "look", "channel": 0, "width": 10, "from_s": NaN}',
        '{"number": 1, "do": "look", "channel": 0, "width": 10, "from_s": 1e999}',
        '{"number": 1, "do": "turn", "channel": 0, "settings": {"noise_std": -1.0}}',
        '{"number": 1, "do": "turn", "channel": 0, "settings": {"noise_std": "1"}}',
        '{"number": 1, "do": "turn", "channel": 0, "settings": {"choice": "order-9"}}',
        '{"number": 1, "do": "turn", "channel": 0, "settings": {"on": {"warp": false}}}',
        '{"number": 1, "do": "mode", "mode": "lagged"}',
        '{"number": 1, "do": "mode", "mode": "lagged", "lag_s": 1e-9}',
        '{"number": 1, "do": "compare", "channel": 0, "classic": "magic"}',
        '{"number": 1, "do": "restore", "recipe": "not toml at all ="}',
        '{"number": 1, "do": "open", "file": "folder/../../etc/passwd"}',
        '{"number": 1, "do": "map", "channel": 1e3}',
        '{"number": 1' + "9" * 400 + ', "do": "undo"}',
    ],
)
def test_bad_messages_are_answered_and_the_wire_stays_open(page: Talk, sent: str) -> None:
    page.wire.send(sent)
    trouble = page.until("trouble").told
    assert len(trouble["says"]) > 20
    assert "Traceback" not in trouble["says"]
    found = page.picture(page.ask("look", channel=0, width=10))
    assert len(found.arrays["t"]) == 10


def test_numbers_that_make_no_filter_are_refused_in_a_sentence(page: Talk) -> None:
    page.picture(page.ask("look", channel=0, width=10))
    page.ask("turn", channel=0, settings={"noise_std": 1e-300}, final=False)
    assert "do not make a valid filter" in page.until("trouble").told["says"]
    page.ask("turn", channel=0, settings={"choice": "found"})
    page.until("picture")


def test_the_map_is_least_at_its_best_and_marks_what_is_set(page: Talk) -> None:
    number = page.ask("map", channel=1)
    found = page.until("map")
    assert found.told["answers"] == number
    cost = found.arrays["cost"].reshape(len(found.told["noise_std"]), len(found.told["process_noise_density"]))
    assert cost[tuple(found.told["best"])] == 0.0 == cost.min()
    assert found.told["noise_std"][found.told["best"][0]] == pytest.approx(1.0, rel=0.3)
    assert found.told["here"][0] == pytest.approx(1.0, rel=0.1)
    assert found.told["density_unit"] == "1/s"


def test_a_classic_filter_is_drawn_beside(page: Talk) -> None:
    page.picture(page.ask("look", channel=1, width=300))
    number = page.ask("compare", channel=1, classic="Savitzky-Golay 3")
    found = page.until("picture", lambda heard: heard.told["classic"] is not None and heard.told["answers"] >= number)
    assert found.told["classic"] == "Savitzky-Golay 3"
    assert np.abs(found.arrays["classic_high"] - found.arrays["clean_high"]).max() < 1.0
    page.ask("compare", channel=1, classic=None)


def test_a_mode_is_tuned_for_itself_and_undone(page: Talk) -> None:
    smoothed = page.picture(page.ask("look", channel=1, width=300)).told["filter"]
    number = page.ask("mode", mode="causal")
    recording = page.until("recording").told  # models, their evidence and parts are others
    assert recording["mode"] == "causal"
    state = page.until("state").told
    assert state["mode"] == "causal"
    assert "Butterworth 2" in state["classics"]
    causal = page.picture(number).told["filter"]
    assert smoothed["lag_s"] == 0.0 < causal["lag_s"]
    number = page.ask("mode", mode="lagged", lag_s=0.1)
    assert page.picture(number).told["filter"]["lag_s"] == pytest.approx(0.1)
    for _ in range(2):
        page.ask("undo")
        state = page.until("state").told
    assert state["mode"] == "smoothed"


def test_a_recipe_brings_back_what_was_done(page: Talk) -> None:
    page.ask("turn", channel=0, settings={"choice": "order-3", "on": {"tone-0": False}})
    page.until("state")
    page.ask("turn", channel=1, settings={"process_noise_density": 0.25, "unchanged": False})
    recipe = page.until("state").told["recipe"]
    for channel in (0, 1):
        page.ask("turn", channel=channel, settings={"choice": "found", "on": {"tone-0": True} if channel == 0 else {}})
        assert page.until("state").told["recipe"] != recipe
    page.ask("restore", recipe=recipe)
    state = page.until("state").told
    assert state["recipe"] == recipe
    assert [one["choice"] for one in state["channels"][:2]] == ["order-3", "found"]
    assert not state["channels"][0]["on"]["tone-0"]
    changed = recipe.replace("noise_std = ", "noise_std = 1", 1).replace("agree = 5", "agree = 7", 1)
    assert changed != recipe
    page.ask("restore", recipe=changed)
    state = page.until("state").told
    assert state["channels"][0]["choice"] == "given"
    assert Recipe.from_toml(state["recipe"]).channel == Recipe.from_toml(changed).channel
    for _ in range(2):
        page.ask("undo")
        page.until("state")


def test_another_page_is_told(page: Talk, tuner: Served) -> None:
    with tuner.talk() as other:
        other.until("picture")
        page.ask("turn", channel=1, settings={"process_noise_density": 0.5})
        state = other.until("state", lambda heard: heard.told["channels"][1]["process_noise_density"] == 0.5)
        assert state.told["can_undo"]
        page.ask("undo")
        other.until("state")


def test_a_page_that_comes_back_finds_what_was_done(tuner: Served, page: Talk) -> None:
    page.ask("turn", channel=1, settings={"process_noise_density": 0.125})
    done = page.until("state").told["recipe"]
    page.wire.close()
    with tuner.talk() as again:
        assert again.hear().told["file"] == "folder/drive.csv"
        assert again.until("recording").told["name"] == "drive.csv"
        assert again.until("state").told["recipe"] == done
        again.until("picture")
        again.ask("undo")
        again.until("state")


def test_what_cannot_be_read_leaves_what_is_open(page: Talk, tuner: Served) -> None:
    (tuner.folder / "broken.csv").write_text("this,is\nno,recording\n")
    page.ask("open", file="folder/broken.csv")
    assert "broken.csv" in page.until("trouble").told["says"]
    (tuner.folder / "broken.csv").unlink()
    assert page.picture(page.ask("look", channel=0, width=10)).arrays["t"].size == 10


def test_the_file_that_was_named_is_opened_by_itself(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    file = drive_in(tmp_path)
    with served(tmp_path / "elsewhere", file) as tuner, tuner.talk() as page:
        assert page.hear().told["file"] == "given/drive.csv"
        assert page.until("recording").told["name"] == "drive.csv"
        page.until("picture")


def test_what_nobody_foresaw_is_told_and_the_wire_stays_open(page: Talk, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> bytes:
        raise ZeroDivisionError("as it was told to")

    with monkeypatch.context() as patch:
        patch.setattr(picture_sender, "map_frame", broken)
        page.ask("map", channel=0)
        assert "unexpected error" in page.until("trouble").told["says"]
    assert page.picture(page.ask("look", channel=0, width=10)).arrays["t"].size == 10


def test_a_file_with_channels_at_several_times_is_opened_by_group(tmp_path: Path) -> None:
    with tdms.TdmsWriter(tmp_path / "log.tdms") as file:
        for group, rows, step_s in (("fast", 900, 0.01), ("slow", 300, 0.5)):
            readings = np.random.default_rng(rows).normal(size=rows)
            file.write_segment(
                [tdms.ChannelObject(group, "ax", readings, {"wf_increment": step_s, "wf_samples": rows})]
            )
    with served(tmp_path) as tuner, tuner.talk() as page:
        first = page.opened("folder/log.tdms")
        assert (first["group"], first["rows"]) == ("fast", 900)
        assert first["groups"] == ["fast", "slow"]
        assert first["command"].endswith("--group fast")
        page.ask("open", file="folder/log.tdms", group="slow")
        second = page.until("recording").told
        assert (second["group"], second["rows"], second["rate_hz"]) == ("slow", 300, 2.0)
        page.ask("open", file="folder/log.tdms", group="none")
        assert "none" in page.until("trouble").told["says"]
        with tuner.client() as client:
            assert client.get("/save/clean?format=csv").text.count("\n") == 301
