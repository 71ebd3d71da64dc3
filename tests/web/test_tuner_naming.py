"""What a page calls the files that it saves, and what it says to type."""

from __future__ import annotations

from pathlib import Path

import pytest

from becalm.web.tuner.naming import command, stem_of


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("drive.csv", "drive"),
        ("a.b.mf4", "a.b"),
        ("drive.csv.gz", "drive"),
        ("log.tsv.gz", "log"),
        ("plain", "plain"),
        (".csv", "recording"),
    ],
)
def test_names_are_kept_without_their_format(name: str, stem: str) -> None:
    assert stem_of(Path(name)) == stem


@pytest.mark.parametrize(
    ("name", "group", "typed"),
    [
        ("a b.csv", None, "becalm clean 'a b.csv' -o 'a b-clean.csv' --recipe 'a b.recipe.toml'"),
        ("log.tsv.gz", None, "becalm clean log.tsv.gz -o log-clean.csv --recipe log.recipe.toml"),
        ("-x.csv", None, "becalm clean ./-x.csv -o ./-x-clean.csv --recipe ./-x.recipe.toml"),
        ("a.tdms", "slow", "becalm clean a.tdms -o a-clean.tdms --recipe a.recipe.toml --group slow"),
        ("a\x1b[2J.csv", None, ""),
        ("a\n.csv", None, ""),
        ("\udcff.csv", None, ""),
        ("a.tdms", "slow\x03", ""),
    ],
)
def test_what_to_type_is_safe_to_type(name: str, group: str | None, typed: str) -> None:
    assert command(Path(name), group) == typed
