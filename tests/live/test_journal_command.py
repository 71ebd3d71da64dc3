"""`becalm journal DIR`: lists, verifies, exports, prunes, and says what is wrong in a sentence."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from becalm.cli.commands.journal import JournalOptions, moment_of
from becalm.cli.commands.journal import run as export
from becalm.errors import UsageError
from becalm.live.block import Loss, LossKind
from journals import HEAD, checkpoint_at, fill, journal_in, rows_of

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    """Keep two hours and a quarter, two of which are rolled."""
    folder = tmp_path / "j"
    lost = Loss(LossKind.MISSING, 4, "4 rows never came", 1.7e9)
    with journal_in(folder) as journal:
        journal.commit([rows_of(0, 10_000, losses=(lost,))], checkpoint_at(10_000))
        fill(journal, 7, 10_000)
    return folder


def test_list_tells_hours_rows_rate_losses_and_position(journal: Path, run: Run) -> None:
    ran = run("journal", journal)
    assert ran.returncode == 0, ran.stderr
    lines = ran.stdout.splitlines()
    first = "2023-11-14/22.parquet 28,000 2023-11-14 22:13:20 2023-11-14 22:59:59 10"
    assert " ".join(lines[1].split()[:-1]) == first
    assert [line.split()[0] for line in lines[1:4]] == [
        "2023-11-14/22.parquet",
        "2023-11-14/23.parquet",
        "journal.sqlite",
    ]
    assert "80,000 rows of ax (m/s^2), strain (um/m) from replay:drive.csv" in ran.stdout
    assert "missing: 1 reported; the last: 4 rows never came" in ran.stdout
    assert 'The source continues after {"row": 80000}' in ran.stdout
    told = json.loads(run("journal", journal, "list", "--json").stdout)
    assert told["rows"] == 80_000
    assert [hour["rows"] for hour in told["hours"]] == [28_000, 36_000, 16_000]
    assert told["hours"][1]["rate_hz"] == pytest.approx(10.0)
    assert told["losses"] == {"missing": 1}


def test_verify_is_content_and_then_finds_what_changed(journal: Path, run: Run) -> None:
    ran = run("journal", journal, "verify", "--json")
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout) == {"folder": str(journal), "whole": True, "rows": 80_000, "wrong": [], "lost": []}
    assert "is intact: 80,000 rows" in ran.stderr
    path = journal / "2023-11-14" / "22.parquet"
    content = bytearray(path.read_bytes())
    content[1000] ^= 1
    path.write_bytes(content)
    ran = run("journal", journal, "verify")
    assert ran.returncode == 3
    assert "22.parquet, which holds rows 0 to 27999, differs from what was written." in ran.stderr


def test_a_damaged_database_is_told_by_every_command(journal: Path, run: Run, tmp_path: Path) -> None:
    with (journal / "journal.sqlite").open("r+b") as file:
        file.truncate(20_000)
    for words in (["list"], ["verify"], ["export", "-o", tmp_path / "out.csv"], ["prune", "--older", "1d"]):
        ran = run("journal", journal, *words)
        assert ran.returncode in (3, 5), words
        assert "Traceback" not in ran.stderr
        assert "journal" in ran.stderr
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("content", [b"", b"noise" * 5000])
def test_verify_says_of_the_database_that_it_is_damaged(content: bytes, journal: Path, run: Run) -> None:
    for path in journal.glob("journal.sqlite*"):
        path.unlink()
    (journal / "journal.sqlite").write_bytes(content)
    ran = run("journal", journal, "verify", "--json")
    assert ran.returncode == 3
    (said,) = json.loads(ran.stdout)["wrong"]
    assert said.startswith("journal.sqlite is damaged (")
    assert "can be restarted" in ran.stderr


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_export_writes_the_rows_between_two_stamps(ending: str, journal: Path, run: Run, tmp_path: Path) -> None:
    path = tmp_path / f"out.{ending}"
    ran = run("journal", journal, "export", "-o", path, "--from", "2023-11-14T22:59:00", "--to", "1700006400.5")
    assert ran.returncode == 0, ran.stderr
    table = pyarrow.csv.read_csv(path) if ending == "csv" else pq.read_table(path)
    assert table["row"].to_pylist() == list(range(27_400, 64_005))
    assert "Wrote 36,605 rows" in ran.stderr
    if ending == "parquet":
        assert table.schema.metadata[b"recipe"] == HEAD.recipe.encode()


def test_what_is_exported_can_be_read_and_cleaned_again(journal: Path, run: Run) -> None:
    assert run("journal", journal, "export", "-o", "all.parquet").returncode == 0
    told = json.loads(run("inspect", "all.parquet", "--json").stdout)
    assert told["rate_hz"] == pytest.approx(10.0)


def test_an_export_of_no_rows_has_its_columns(journal: Path, run: Run, tmp_path: Path) -> None:
    ran = run("journal", journal, "export", "-o", "none.parquet", "--to", "0")
    assert ran.returncode == 0, ran.stderr
    assert pq.read_table(tmp_path / "none.parquet").column_names[:3] == ["row", "time_s", "ax"]


def test_prune_removes_what_is_old(journal: Path, run: Run) -> None:
    ran = run("journal", journal, "prune", "--older", "1d")
    assert ran.returncode == 0, ran.stderr
    assert "Removed 2 files with 64,000 rows" in ran.stderr
    assert not list(journal.glob("*/*"))
    assert run("journal", journal, "verify").returncode == 0
    assert "2023-11-14/22.parquet (pruned)" in run("journal", journal).stdout


def test_words_the_wrong_way_round_are_told_the_right_way(run: Run) -> None:
    ran = run("journal", "list", "j")
    assert (ran.returncode, ran.stderr) == (2, "becalm: The folder comes first: becalm journal j list\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["burn"], "cannot burn; it can list, verify, export, prune"),
        (["export"], "needs an output"),
        (["export", "-o", "out.doc"], "out.doc"),
        (["export", "-o", "o.csv", "--from", "yesterday"], "--from yesterday is not a time"),
        (["prune"], "needs the age of the files to remove: --older 30d"),
        (["prune", "--older", "old"], "--older old is not a time"),
    ],
)
def test_mistakes_are_sentences(words: list[str], said: str, journal: Path, run: Run) -> None:
    ran = run("journal", journal, *words)
    assert ran.returncode == 2
    assert said in ran.stderr


@pytest.mark.parametrize("action", ["list", "verify", "export", "prune"])
def test_a_folder_without_a_journal_is_a_sentence(action: str, run: Run, tmp_path: Path) -> None:
    ran = run("journal", tmp_path, action, "-o", "o.csv", "--older", "1d")
    assert ran.returncode == 3
    assert "holds no journal (journal.sqlite)" in ran.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_date_is_utc_unless_it_says_otherwise() -> None:
    assert moment_of("--from", "2023-11-14T22:13:20", 0.0) == 1_700_000_000.0
    assert moment_of("--from", "2023-11-14T23:13:20+01:00", 0.0) == 1_700_000_000.0
    assert moment_of("--from", None, 7.0) == 7.0
    with pytest.raises(UsageError, match="is not a time"):
        moment_of("--to", "nan", 0.0)


@pytest.mark.parametrize(("text", "date"), [("20231115", "2023-11-15"), ("2026", "2026-01-01")])
def test_what_could_be_seconds_or_a_date_is_refused(text: str, date: str) -> None:
    with pytest.raises(UsageError, match=f"write {text}.0 for seconds, or {date}"):
        moment_of("--from", text, 0.0)
    assert moment_of("--from", f"{text}.0", 0.0) == float(text)
    assert moment_of("--from", date, 0.0) > 1e9
    assert moment_of("--from", "3600", 0.0) == 3600.0


def test_an_export_into_the_journal_is_refused(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 1)
    output = tmp_path / "x" / ".." / "2023-11-14" / "22.parquet"
    with pytest.raises(UsageError, match="in the journal"):
        export(tmp_path, "export", JournalOptions(output, None, None, None), as_json=False)
    assert not output.exists()
