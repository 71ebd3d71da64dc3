"""What is run after an edit: tests that import what changed, however it is found."""

from __future__ import annotations

from pathlib import Path

import pytest

import changed


@pytest.mark.parametrize(
    ("file", "test"),
    [
        ("src/becalm/core/filter/gate.py", "tests/core/test_gate.py"),
        ("src/becalm/files/recorders/wav.py", "tests/files/test_wav.py"),  # loaded by its name alone
        ("src/becalm/native/gate.h", "tests/core/test_channel.py"),
        ("src/becalm/web/assets/tuner.html", "tests/web/test_serving.py"),
        ("tests/house/test_after_an_edit.py", "tests/house/test_after_an_edit.py"),
    ],
)
def test_an_edit_is_tested(file: str, test: str) -> None:
    assert (changed.ROOT / file).exists()
    assert changed.ROOT / test in changed.tests_of(changed.ROOT / file)


def test_what_no_test_can_see_runs_none() -> None:
    assert changed.tests_of(Path(changed.ROOT / "README.md")) == []


def test_every_module_has_a_test_near() -> None:
    without = [
        str(file.relative_to(changed.SRC))
        for file in changed.SRC.rglob("*.py")
        if not file.name.startswith("__") and not changed.tests_of(file)
    ]
    assert without == []
