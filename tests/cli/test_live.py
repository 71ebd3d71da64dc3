"""`becalm live` as a person runs it: files, pipes, kills, signals, and mistakes that end in sentences."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import becalm
import becalm.cli.commands.live
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cli.commands.live import LiveOptions, MonitoringOptions
from becalm.errors import UsageError
from becalm.live.journal.reading import open_journal
from becalm.live.running.stream_start import StreamStarter
from live_processes import DEADLINE_S, begun, kept, rows_in, told_in, until

Run = Callable[..., subprocess.CompletedProcess[str]]


TUNED: list[str] = []  # the recipe of the drive, which is the same in all tests


@pytest.fixture
def recipe(drive: Path) -> Path:
    if not TUNED:
        TUNED.append(becalm.tune(becalm.read(drive), causal=True).to_toml())
    path = drive.with_name("r.toml")
    path.write_text(TUNED[0], encoding="utf-8")
    return path


def test_a_file_replayed_gives_what_clean_gives(run: Run, drive: Path, recipe: Path, tmp_path: Path) -> None:
    ran = run("live", f"replay:{drive}", "--recipe", recipe, "--status", "s.json")
    assert ran.returncode == 0, ran.stderr
    clean = becalm.clean(becalm.read(drive), Recipe.load(recipe), causal=True)
    table = kept(tmp_path / "becalm-journal")
    for number, name in enumerate(clean.signal.names):
        np.testing.assert_allclose(table[name], clean.signal.samples[:, number], rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(table[f"{name}_sigma"], clean.sigma.samples[:, number], rtol=1e-12)
    status = json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))
    assert (status["state"], status["rows"]) == ("ended", 400)


def test_without_a_recipe_it_learns_saves_and_goes_on(run: Run, drive: Path, tmp_path: Path) -> None:
    ran = run("live", f"replay:{drive}", "--sink", "journal:kept", "--learn", "2s")
    assert ran.returncode == 0, ran.stderr
    assert [one.name for one in Recipe.load(tmp_path / "kept" / "learned.recipe.toml").channel] == [
        "ramp (m/s)",
        "walk",
    ]
    assert kept(tmp_path / "kept").num_rows == 400
    again = run("live", f"replay:{drive}", "--sink", "journal:kept")
    assert again.returncode == 0, again.stderr
    assert kept(tmp_path / "kept").num_rows == 400


def test_killed_again_and_again_it_keeps_every_row_once(drive: Path, recipe: Path, tmp_path: Path, run: Run) -> None:
    status = tmp_path / "s.json"
    words = ["--recipe", recipe, "--commit", "0.05s", "--status", status]
    for lives in range(2):
        with begun(tmp_path, [f"replay:{drive}?speed=1&rows=10", *words, "--sink", "journal:kept"]) as process:
            before = kept(tmp_path / "kept").num_rows if lives else 0
            until(lambda before=before: (tmp_path / "kept").exists() and _rows_of(tmp_path / "kept") > before + 20)
            process.kill()
    assert run("live", f"replay:{drive}", *words, "--sink", "journal:kept").returncode == 0
    assert run("live", f"replay:{drive}", *words, "--sink", "journal:whole").returncode == 0
    assert kept(tmp_path / "kept").drop_columns([]).equals(kept(tmp_path / "whole"))


def _rows_of(journal: Path) -> int:
    try:
        return int(kept(journal).num_rows)
    except (becalm.errors.BecalmError, pa.ArrowInvalid):  # it has not begun
        return 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_finishes_the_commit(number: signal.Signals, drive: Path, recipe: Path, tmp_path: Path) -> None:
    status = tmp_path / "s.json"
    words = [f"replay:{drive}?speed=1&rows=5", "--recipe", recipe, "--commit", "1h", "--status", status]

    def hear() -> None:  # what runs in the background of a shell ignores it
        signal.signal(signal.SIGINT, signal.default_int_handler)

    with begun(tmp_path, words, preexec_fn=hear) as process:
        until(lambda: rows_in(status) > 0)
        process.send_signal(number)
        assert process.wait(DEADLINE_S) == 0
    told = rows_in(status)
    assert 0 < told < 400
    assert kept(tmp_path / "becalm-journal").num_rows == told


def test_a_pipe_goes_to_a_pipe(drive: Path, recipe: Path, run: Run) -> None:
    text = drive.read_text(encoding="utf-8").replace("time_s,", "time,")
    lines = text.splitlines(keepends=True)
    broken = "".join([*lines[:50], "nothing of use\n1,2\n", *lines[50:]])
    ran = run("live", "stdin:", "--recipe", recipe, "--sink", "stdout:", input=broken)
    assert ran.returncode == 0, ran.stderr
    told = ran.stdout.splitlines()
    assert told[0].startswith("time,ramp")
    assert len(told) == 401
    assert "kind=garbled" in ran.stderr


def test_a_closed_reader_ends_in_a_sentence(drive: Path, recipe: Path, tmp_path: Path) -> None:
    words = [f"replay:{drive}?speed=1", "--recipe", recipe, "--sink", "stdout:", "--sink", "journal:kept"]
    with begun(tmp_path, words, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.stdout.close()
        process.stdout = None
        assert process.stderr is not None
        said = process.stderr.read().decode()
        assert process.wait(DEADLINE_S) != 0
    assert "Traceback" not in said
    assert kept(tmp_path / "kept").num_rows > 0


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signal here")
def test_hanging_up_reads_the_recipe_again(drive: Path, recipe: Path, tmp_path: Path) -> None:
    status = tmp_path / "s.json"
    words = [f"replay:{drive}?speed=0.1&rows=1", "--recipe", recipe, "--commit", "0.1s", "--status", status]

    def hear() -> None:  # what nohup begins ignores it
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    with begun(tmp_path, words, preexec_fn=hear) as process:
        until(lambda: rows_in(status) > 0)
        text = recipe.read_text(encoding="utf-8").replace("tuning_spread = 0.", "tuning_spread = 1.")
        assert "tuning_spread = 1." in text
        recipe.write_text(text, encoding="utf-8")
        before = told_in(status)["recipe_sha256"]
        process.send_signal(signal.SIGHUP)
        until(lambda: told_in(status).get("recipe_sha256") != before)
        recipe.write_text("no recipe", encoding="utf-8")
        process.send_signal(signal.SIGHUP)  # which is refused, and the stream goes on
        recipe.write_text(text, encoding="utf-8")
        process.send_signal(signal.SIGTERM)
        assert process.wait(DEADLINE_S) == 0
    with open_journal(tmp_path / "becalm-journal") as reader:
        checkpoint = reader.checkpoint()
    assert checkpoint is not None
    assert Recipe.from_toml(checkpoint.recipe) == Recipe.load(recipe)


MISTAKES: dict[str, tuple[list[str], str]] = {
    "no kind": (["drive.csv"], "KIND:"),
    "unknown kind": (["carrier:pigeon"], "is not a source"),
    "unknown sink": (["stdin:", "--sink", "abacus:"], "is not a sink"),
    "unknown option": (["stdin:?colour=red"], "colour"),
    "two keepers": (["stdin:", "--sink", "journal:a", "--sink", "journal:b"], "Only one"),
    "no such file": (["replay:nowhere.csv"], "nowhere.csv"),
    "no such recipe": (["stdin:", "--recipe", "nowhere.toml"], "nowhere.toml"),
    "no time": (["stdin:", "--learn", "soon"], "--learn soon"),
    "no time to commit": (["stdin:", "--commit", "1"], "--commit 1"),
    "no queue": (["stdin:", "--queue", "0"], "--queue 0"),
    "no policy": (["stdin:", "--when-full", "panic"], "panic"),
    "no folder for a status": (["stdin:", "--status", "nowhere/s.json"], "nowhere"),
    "nothing came": (["stdin:"], "needs 64"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_ends_in_a_sentence(name: str, run: Run, tmp_path: Path) -> None:
    words, says = MISTAKES[name]
    ran = run("live", *words, input="time,ax\n0,1\n")
    assert ran.returncode in (2, 3), ran.stderr
    assert says in ran.stderr
    assert "Traceback" not in ran.stderr


def test_another_recipe_takes_over_at_a_restart(run: Run, drive: Path, recipe: Path, tmp_path: Path) -> None:
    text = drive.read_text(encoding="utf-8")
    status = tmp_path / "s.json"
    with begun(tmp_path, [f"replay:{drive}?speed=1&rows=5", "--recipe", recipe, "--status", status]) as process:
        until(lambda: rows_in(status) > 0)
        process.send_signal(signal.SIGTERM)
        assert process.wait(DEADLINE_S) == 0
    quieter = recipe.with_name("quieter.toml")
    quieter.write_text(recipe.read_text(encoding="utf-8").replace("tuning_spread = 0.", "tuning_spread = 1."))
    ran = run("live", f"replay:{drive}", "--recipe", quieter)
    assert ran.returncode == 0, ran.stderr
    assert kept(tmp_path / "becalm-journal").num_rows == len(text.splitlines()) - 1


def test_another_stream_in_the_same_journal_is_refused(run: Run, drive: Path, recipe: Path) -> None:
    assert run("live", f"replay:{drive}", "--recipe", recipe).returncode == 0
    other = drive.with_name("other.csv")
    other.write_bytes(drive.read_bytes())
    ran = run("live", f"replay:{other}", "--recipe", recipe)
    assert ran.returncode == 2
    assert "another place" in ran.stderr


def test_secrets_are_in_no_log(run: Run, drive: Path, recipe: Path, tmp_path: Path) -> None:
    os.environ["BECALM_MQTT_PASSWORD"] = "rosebud"
    try:
        ran = run("live", f"replay:{drive}", "--recipe", recipe, "--log", "l.jsonl", "--status", "s.json")
    finally:
        del os.environ["BECALM_MQTT_PASSWORD"]
    assert ran.returncode == 0, ran.stderr
    for path in tmp_path.rglob("*"):
        assert path.is_dir() or b"rosebud" not in path.read_bytes(), path


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("stderr", ["2>/dev/full", "2>&-"])
def test_a_stream_that_learns_needs_no_terminal(stderr: str, drive: Path, tmp_path: Path) -> None:
    words = f"live stdin: --learn 1s --sink journal:kept --log log.jsonl < {drive} {stderr}"
    subprocess.run(f"{sys.executable} -m becalm {words}", shell=True, cwd=tmp_path, check=False)
    assert kept(tmp_path / "kept").num_rows == 400


def test_a_closed_output_is_a_sentence(drive: Path, recipe: Path, tmp_path: Path) -> None:
    words = f"live replay:{drive} --recipe {recipe} --sink stdout: >&-"
    ran = subprocess.run(
        f"{sys.executable} -m becalm {words}", shell=True, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False
    )
    assert ran.returncode == 2
    assert "Standard output is closed" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_noise_alone_is_counted(recipe: Path, run: Run) -> None:
    ran = run("live", "stdin:", "--recipe", recipe, input="nothing\nof use\n")
    assert ran.returncode == 0
    assert "kind=garbled events=1 rows=2" in ran.stderr


@pytest.fixture
def unstamped(drive: Path, run: Run) -> Path:
    """Return rows without stamps, beside the recipe (rows.toml) that counts them."""
    path = drive.with_name("rows.csv")
    rows = [line.split(",", 1)[1] for line in drive.read_text(encoding="utf-8").splitlines()]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    assert run("tune", "rows.csv", "-o", "rows.toml", "--causal", "--rate", "100").returncode == 0
    return path


def test_rows_are_counted_as_the_recipe_counts_them(unstamped: Path, run: Run) -> None:
    cleaned = run("clean", "rows.csv", "-o", "calm.csv", "--recipe", "rows.toml", "--causal")
    assert cleaned.returncode == 0, cleaned.stderr
    wanted = becalm.read(unstamped.with_name("calm.csv"), rate_hz=100.0).samples[:, 0]
    for number, source in enumerate(["replay:rows.csv", "stdin:"]):
        words = ["--recipe", "rows.toml", "--sink", f"journal:kept{number}"]
        ran = run("live", source, *words, input=unstamped.read_text(encoding="utf-8"))
        assert ran.returncode == 0, ran.stderr
        found = kept(unstamped.with_name(f"kept{number}"))
        np.testing.assert_allclose(found[found.column_names[2]].to_numpy(), wanted, rtol=1e-9)


def test_rows_are_counted_on_by_the_recipe_that_the_stream_had(unstamped: Path, tmp_path: Path, run: Run) -> None:
    status = tmp_path / "s.json"
    with begun(tmp_path, ["replay:rows.csv?speed=1&rows=5", "--recipe", "rows.toml", "--status", status]) as process:
        until(lambda: rows_in(status) > 0)
        process.send_signal(signal.SIGTERM)
        assert process.wait(DEADLINE_S) == 0
    assert run("live", "replay:rows.csv").returncode == 0
    assert run("live", "replay:rows.csv", "--recipe", "rows.toml", "--sink", "journal:whole").returncode == 0
    assert kept(tmp_path / "becalm-journal").equals(kept(tmp_path / "whole"))


@pytest.mark.parametrize(
    ("source", "sinks", "opened"),
    [
        ("udp:9000", ["journal:kept"], "udp:9000?gather=0.050000s"),
        ("udp:9000?rate=100", [], "udp:9000?rate=100&gather=0.050000s"),
        ("udp:9000?gather=0ms", ["journal:kept"], "udp:9000?gather=0ms"),
        ("udp:9000", ["journal:kept", "stdout:"], "udp:9000"),
        ("stdin:", ["journal:kept"], "stdin:"),
    ],
)
def test_datagrams_gather_where_only_a_commit_waits(
    source: str, sinks: list[str], opened: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def refused(name: str) -> None:
        asked.append(name)
        raise UsageError("Enough.")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(becalm.cli.commands.live, "open_source", refused)
    settings = becalm.cli.commands.live.settings_of(10, "block", "1s")
    asking, watching = LiveOptions(None, "2s", None, ()), MonitoringOptions(None, None, "-", "10s")
    with pytest.raises(UsageError, match="Enough"):
        becalm.cli.commands.live.run(source, sinks, asking, settings, watching)
    assert asked == [opened]


def test_a_recipe_gets_the_lag_and_the_channels_that_are_asked_for(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starters: list[StreamStarter] = []

    def refused(starter: StreamStarter, **_: object) -> None:
        starters.append(starter)
        raise UsageError("Enough.")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(becalm.cli.commands.live, "Runner", refused)
    settings = becalm.cli.commands.live.settings_of(10, "block", "1s")
    (name, *_) = (channel.name for channel in reversed(Recipe.load(recipe).channel))
    asking, watching = LiveOptions(recipe, "2s", 0.5, (name,)), MonitoringOptions(None, None, "-", "10s")
    with pytest.raises(UsageError, match="Enough"):
        becalm.cli.commands.live.run("stdin:", [], asking, settings, watching)
    (given,) = (starter.recipe for starter in starters)
    assert given is not None
    assert (given.mode, given.lag_s, [channel.name for channel in given.channel]) == ("lagged", 0.5, [name])
