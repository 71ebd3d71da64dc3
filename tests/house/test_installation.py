"""What is said of this installation, and how commands are typed on this system."""

from __future__ import annotations

import pytest

from becalm import installation


@pytest.mark.parametrize(("system", "typed"), [("posix", "becalm clean 'a b.csv'"), ("nt", 'becalm clean "a b.csv"')])
def test_commands_are_quoted_as_the_system_reads_them(system: str, typed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("becalm.installation.os.name", system)
    assert installation.typed("becalm", "clean", "a b.csv") == typed
