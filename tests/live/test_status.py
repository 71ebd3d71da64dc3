"""The status file: whole at every moment, and no reason to stop a stream."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from becalm.errors import OutputError
from becalm.live.block import Loss, LossKind
from becalm.live.watching import status
from becalm.live.watching.meter import Meter
from becalm.live.watching.status import StatusFile
from metered import output_of, used


def wait_until_rows(path: Path, rows: int) -> None:
    deadline = time.monotonic() + 30
    while json.loads(path.read_text(encoding="utf-8"))["rows"] != rows:  # raises if it is ever in part
        assert time.monotonic() < deadline, f"{path} never told {rows} rows"


def test_it_is_there_at_once_follows_and_tells_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status, "EVERY_S", 0.001)
    meter, path, said = Meter(), tmp_path / "status.json", list[str]()
    with StatusFile(path, meter, said.append) as file:
        for rows in range(1, 6):
            meter.record(used(1, 0.0))
            wait_until_rows(path, rows)
        meter.state("ended", "All was told.")
        file.close()
        assert json.loads(path.read_text(encoding="utf-8"))["state"] == "ended"
    assert [each.name for each in tmp_path.iterdir()] == ["status.json"]
    assert said == []


def test_it_holds_no_secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BECALM_MQTT_PASSWORD", "rosebud")
    meter, path = Meter("mqtt://me:other@host/topic"), tmp_path / "status.json"
    meter.state("away", "rosebud was refused.")
    meter.record(output_of(np.zeros((0, 2), np.int8), 0.0, [Loss(LossKind.AWAY, None, "rosebud was refused.")]))
    StatusFile(path, meter, print).close()
    text = path.read_text(encoding="utf-8")
    assert "was refused" in text
    assert "rosebud" not in text
    assert "other" not in text


def test_what_cannot_be_written_is_said_once_and_again_when_it_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status, "EVERY_S", 0.001)
    folder, said = tmp_path / "gone", list[str]()
    folder.mkdir()
    path = folder / "status.json"
    with StatusFile(path, Meter(), said.append):
        folder.rename(tmp_path / "moved")
        deadline = time.monotonic() + 30
        while not said:
            assert time.monotonic() < deadline
        folder.mkdir()
        while not path.exists():
            assert time.monotonic() < deadline
    assert len(said) == 2
    assert f"The status file {path} cannot be written (No such file or directory)" in said[0]
    assert "written again" in said[1]


@pytest.mark.parametrize("name", ["", "no/such/folder/status.json"])
def test_a_file_that_can_never_be_is_refused_before_the_stream_begins(name: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"directory|folder"):
        StatusFile(tmp_path / name, Meter(), print)
