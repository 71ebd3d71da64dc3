"""What is deployed calls commands and options that exist, and knows a stream that is alive from one that is not."""

from __future__ import annotations

import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from configparser import RawConfigParser
from pathlib import Path

import pytest
import typer

from becalm.cli import main
from becalm.live.watching.status import StatusFile
from metered import Clock, metered

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
UNIT = DEPLOY / "becalm@.service"
OPTION = r"(?<![\w-])--[a-z][a-z-]+"


def options_of(command: str) -> set[str]:
    """Return the options of one of becalm's commands."""
    group = typer.main.get_command(main.app)
    found = getattr(group, "commands", {}).get(command)
    assert found is not None, f"becalm has no command {command}"
    return {name for each in found.params for name in (*each.opts, *each.secondary_opts)} | {"--help"}


class Unit(RawConfigParser):
    """A unit's sections, where a name may stand several times, and letters keep their case."""

    def __init__(self) -> None:
        super().__init__(strict=False, delimiters=("=",), comment_prefixes=("#", ";"))
        self.read_string(UNIT.read_text(encoding="utf-8"))

    def optionxform(self, optionstr: str) -> str:
        return optionstr


def commands() -> Iterator[list[str]]:
    """Tell all calls of becalm that unit, image and page hold, as words."""
    yield shlex.split(Unit()["Service"]["ExecStart"])
    entry = re.search(r"^ENTRYPOINT (\[.*\])$", (DEPLOY / "Containerfile").read_text(encoding="utf-8"), re.M)
    assert entry is not None
    yield json.loads(entry[1])
    page = (DEPLOY / "README.md").read_text(encoding="utf-8")
    for options in re.findall(r"^OPTIONS=(.*)$", page, re.M):
        yield ["becalm", "live", *options.split()]
    for run in re.findall(r" becalm (mqtt:.*)$", page, re.M):
        yield ["becalm", "live", *run.split()]


@pytest.mark.parametrize("words", list(commands()), ids=" ".join)
def test_what_is_called_exists(words: list[str]) -> None:
    program, command, *rest = words
    assert Path(program).name == "becalm"
    assert set(re.findall(OPTION, " ".join(rest))) <= options_of(command)


def test_the_unit_restarts_watches_and_stops_gently() -> None:
    unit = Unit()
    service = unit["Service"]
    assert unit["Unit"]["StartLimitIntervalSec"] == "0"
    assert (service["Type"], service["Restart"], service["KillSignal"]) == ("notify", "always", "SIGTERM")
    assert service["WatchdogSec"] == "60s"
    assert (service["DynamicUser"], service["ProtectSystem"], service["PrivateTmp"]) == ("yes", "strict", "yes")
    assert not service.get("MemoryDenyWriteExecute")  # filters are compiled in memory


def test_systemd_understands_the_unit(tmp_path: Path) -> None:
    verify = shutil.which("systemd-analyze")
    if verify is None:
        pytest.skip("systemd-analyze is not here")
    installed = tmp_path / "becalm@strain.service"
    installed.write_text(
        UNIT.read_text(encoding="utf-8").replace("/opt/becalm/bin/becalm", sys.executable), encoding="utf-8"
    )
    ran = subprocess.run([verify, "verify", str(installed)], capture_output=True, text=True, check=False)
    assert "becalm@strain" not in ran.stderr
    assert ran.returncode == 0, ran.stderr


def health_of(status: Path) -> str | None:
    found = runpy.run_path(str(DEPLOY / "healthy.py"))["trouble"](status)
    assert found is None or isinstance(found, str)
    return found


def test_a_stream_that_turns_is_healthy_wherever_its_source_is(tmp_path: Path) -> None:
    path, meter = tmp_path / "status.json", metered()
    meter.state("away", "No broker.")
    StatusFile(path, meter, print).close()
    assert health_of(path) is None
    ran = subprocess.run([sys.executable, str(DEPLOY / "healthy.py"), str(path)], capture_output=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, b"")


def test_a_stream_that_hangs_failed_or_is_gone_is_not_healthy(tmp_path: Path) -> None:
    path, clock = tmp_path / "status.json", Clock()
    assert "No status" in (health_of(path) or "")
    meter = metered(clock=clock)
    clock.now_s += 61
    StatusFile(path, meter, print).close()
    assert health_of(path) == "The main loop has stood still for 61 s."
    meter.record_iteration()
    meter.state("failed", "No room.")
    StatusFile(path, meter, print).close()
    assert health_of(path) == "The stream failed. No room."
    os.utime(path, (path.stat().st_atime, path.stat().st_mtime - 100))
    assert "s old" in (health_of(path) or "")
    ran = subprocess.run([sys.executable, str(DEPLOY / "healthy.py"), str(path)], capture_output=True, check=False)
    assert ran.returncode == 1
    assert b"s old" in ran.stderr


def test_the_image_copies_what_is_there() -> None:
    text = (DEPLOY / "Containerfile").read_text(encoding="utf-8")
    copied = [line.split()[1:-1] for line in text.splitlines() if line.startswith("COPY")]
    assert all((ROOT / name).exists() for names in copied for name in names)
    health = re.search(r'CMD \["python", "(.*?)", "(.*?)"\]', text)
    assert health is not None
    assert f"COPY deploy/healthy.py {health[1]}\n" in text
    assert f'"--status", "{health[2]}"' in text
