"""Logs: a line for whatever happens, losses counted together, and never a secret."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from becalm.errors import OutputError, UsageError
from becalm.live.block import Loss, LossKind
from becalm.live.watching import logs
from becalm.live.watching.logs import Log
from becalm.live.watching.scrubber import Scrubber
from metered import Clock

SECRETS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0*"), min_size=4, max_size=30)
TEXTS = st.text(max_size=20)


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def texts(value: Any) -> Iterator[str]:
    """Tell all texts of a value, without the escapes of JSON, in which 0000 may stand by chance."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for each in (*value, *value.values()) if isinstance(value, dict) else value:
            yield from texts(each)


@given(
    SECRETS, st.lists(TEXTS, min_size=2), st.sampled_from(["MQTT_PASSWORD", "nats_token", "APP_SECRET", "PGPASSWORD"])
)
def test_a_secret_of_the_environment_never_comes_out(secret: str, around: list[str], name: str) -> None:
    assume(not any(secret in part for part in around))
    scrub = Scrubber({name: secret, "HOME": "here", "OTHER_PASSWORD": "abcd"})
    text = secret.join(around)
    assert secret not in scrub.scrub_text(text)
    told = scrub(
        None, "", {"event": text, "deep": {"list": [text, (text,)], text: {"cause": ValueError(text)}}, "rows": 3}
    )
    assert all(secret not in each for value in told.values() for each in texts(value))
    assert told["rows"] == 3


@given(SECRETS)
def test_a_secret_is_hidden_however_it_is_written(secret: str) -> None:
    scrub = Scrubber({"A_TOKEN": secret})
    for written in (repr(secret), json.dumps(secret), json.dumps(secret, ensure_ascii=False), ascii(secret)):
        assert written[1:-1] not in scrub.scrub_text(f"<{written}>")
    assert quote(secret, safe="") not in scrub.scrub_text(f"x={quote(secret, safe='')}")


@given(st.text(st.characters(exclude_categories=["Z", "Cc", "Cs"]), min_size=1))
def test_user_and_password_of_an_address_never_come_out(login: str) -> None:
    said = Scrubber({}).scrub_text(f"mqtt://{login}@host:1883/topic is away")
    assert said.startswith("mqtt://***@")
    assert said.endswith("host:1883/topic is away")
    assert len(said) == len("mqtt://***@host:1883/topic is away")


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("udp:9000?gather=50ms", "udp:9000?gather=50ms"),
        ("nats://host/S?token=abc&durable=x", "nats://host/S?token=***&durable=x"),
        ("Password=a b", "Password=*** b"),
        ("?password_file=/etc/p", "?password_file=/etc/p"),
        ("client_secret=s3", "client_secret=***"),
        ("token=abc", "token=***"),
        ("at\nSecret=abc lost", "at\nSecret=*** lost"),
        ("a@b.org wrote", "a@b.org wrote"),
    ],
)
def test_options_that_are_secrets_are_hidden_and_others_told(told: str, said: str) -> None:
    assert Scrubber({}).scrub_text(told) == said


def test_a_value_whose_name_says_that_it_is_secret_is_hidden() -> None:
    told = Scrubber({})(None, "", {"password": "a", "more": {"db_token": 3}, "rate": float("nan")})
    assert told == {"password": "***", "more": {"db_token": "***"}, "rate": "nan"}


def test_lines_of_a_file_are_json_without_secrets_even_in_tracebacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BECALM_MQTT_PASSWORD", 'rose"bud\n')
    path = tmp_path / "live.log"
    with Log(str(path)) as log:
        log.info("start", source="mqtt://me:rosebud@h/t", rows=3)
        try:
            raise ValueError('rose"bud\n')
        except ValueError as cause:
            sentence = log.unexpected(cause)
    start, unexpected = lines_of(path)
    assert (start["event"], start["level"], start["rows"]) == ("start", "info", 3)
    assert start["source"] == "mqtt://***@h/t"
    assert start["timestamp"].endswith("Z")
    assert unexpected["level"] == "error"
    assert "in test_lines_of_a_file" in unexpected["exception"]
    assert "bud" not in path.read_text(encoding="utf-8")
    assert "ValueError" in sentence
    assert str(path) in sentence
    assert "Traceback" not in sentence


def test_lines_on_stderr_are_names_and_values(capsys: pytest.CaptureFixture[str]) -> None:
    with Log() as log:
        log.warning("away", says="No broker at\nhost.", tries=3)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert said.err.endswith(' level=warning event=away says="No broker at\\nhost." tries=3\n')


def test_the_first_loss_is_told_at_once_and_later_ones_once_a_minute(tmp_path: Path) -> None:
    clock, path = Clock(), tmp_path / "live.log"
    log = Log(str(path), {}, clock)
    for number in range(100):
        log.loss(Loss(LossKind.MISSING, 2, f"Loss {number}."))
    log.loss(Loss(LossKind.AWAY, None, "Away."))
    log.log_due_losses()
    clock.now_s += 60
    log.log_due_losses()
    log.loss(Loss(LossKind.MISSING, 2, "Loss 100."))
    log.close()
    log.close()
    told = [(line["kind"], line["events"], line["rows"], line["says"]) for line in lines_of(path)]
    assert told == [
        ("missing", 1, 2, "Loss 0."),
        ("away", 1, 0, "Away."),
        ("missing", 99, 198, "Loss 99."),
        ("missing", 1, 2, "Loss 100."),
    ]


def test_a_log_file_never_grows_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "FILE_BYTES", 2000)
    with Log(str(tmp_path / "live.log"), {}) as log:
        for number in range(500):
            log.info("line", number=number)
    files = sorted(tmp_path.iterdir())
    assert len(files) == logs.OLD_FILES + 1
    assert all(file.stat().st_size <= 2000 for file in files)
    assert lines_of(files[0])[-1]["number"] == 499


def test_a_log_that_cannot_be_renamed_grows_and_loses_no_older_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows renames no file that another program holds open."""
    monkeypatch.setattr(logs, "FILE_BYTES", 2000)
    monkeypatch.setattr(logs, "OLD_FILES", 50)
    rename = Path.replace

    def refuse(path: Path, target: Path) -> Path:
        raise PermissionError(13, "in use")

    with Log(str(tmp_path / "live.log"), {}) as log:
        for number in range(300):
            monkeypatch.setattr(Path, "replace", refuse if 100 <= number < 200 else rename)
            log.info("line", number=number)
    numbers = [line["number"] for file in tmp_path.iterdir() for line in lines_of(file)]
    assert sorted(numbers) == list(range(300))
    assert max(file.stat().st_size for file in tmp_path.iterdir()) > 4000


def test_a_log_that_cannot_be_written_stops_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.setattr(logs, "FILE_BYTES", 10)  # every line begins a file
    with Log(str(folder / "live.log"), {}) as log:
        log.info("one")
        for file in folder.iterdir():
            file.unlink()
        folder.rmdir()
        log.info("two")
        log.info("three")


def test_a_closed_stderr_stops_nothing() -> None:
    code = (
        "import os, sys; from becalm.live.watching.logs import Log\n"
        "log = Log(); sys.stderr.close(); log.info('x'); os.write(1, b'on')"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert ran.stdout == b"on"


def test_a_file_that_can_never_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="directory"):
        Log(str(tmp_path))


def test_without_structlog_a_sentence_says_what_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "structlog", None)
    with pytest.raises(UsageError, match=r"pip install 'becalm\[live\]'"):
        Log()
