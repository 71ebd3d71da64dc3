"""Every line of exported C is reached by what a bundle carries, and what is wrong there is seen."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from banked import bundle_of_bank, bundle_of_banks
from becalm.export.bundle import Bundle
from becalm.export.proof.verifying import write_bundle
from carried import BOTH
from exported import TONE, bundle, channel, need

PRECISIONS = ("float32", "float64")
WHOLE = ("level", "never", "hum", "gated slope", "gated railed")
SETTLED = (
    channel("level", 1, 1e-3),
    channel("thinned", 2, 1e-3),
    channel("tone", 2, 0.05, tone=(TONE,)),
    channel("returning", 2, 0.05, damped_below_hz=0.1),
    channel("coloured", 2, 0.05, coloured_noise=BOTH["coloured"].coloured_noise),
)


def made(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run make in a bundle."""
    need("make")
    return subprocess.run(["make", *words], cwd=cwd, capture_output=True, text=True, check=False, timeout=300)


def missed(of: Bundle, folder: Path) -> list[str]:
    """Return the lines of C that nothing reaches, and whatever failed."""
    need("gcov")
    ran = made("coverage", cwd=write_bundle(of, folder))
    lines = [line for line in ran.stdout.splitlines() if "#####" in line or "FAILED" in line]
    assert lines or (ran.returncode == 0 and "drive.c'\nLines executed:100.00%" in ran.stdout), ran.stderr
    return lines


@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_line_around_the_librarys_channel_is_reached(precision: str, tmp_path: Path) -> None:
    told = [BOTH[one].model_copy(update={"name": f"a{place}"}) for place, one in enumerate(WHOLE)]
    assert missed(bundle(*told, precision=precision, gain="full"), tmp_path) == []


@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_line_of_what_is_written_unasked_is_reached(precision: str, tmp_path: Path) -> None:
    assert missed(bundle(*SETTLED, precision=precision), tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_line_of_all_banks_is_reached(precision: str, tmp_path: Path) -> None:
    """Each has its own lines in a bundle of all; what they share is reached by a bank alone."""
    assert missed(bundle_of_banks(precision), tmp_path) == []


@pytest.mark.parametrize(("name", "precision"), [("jumping 1", "float32"), ("limited", "float64")])
def test_every_line_of_a_bank_is_reached(name: str, precision: str, tmp_path: Path) -> None:
    assert missed(bundle_of_banks(precision, name), tmp_path) == []


@pytest.mark.parametrize(
    ("kind", "right", "wrong", "seen"),
    [
        ("slope", "device_gap(&drive_a_device, drive_a_own(s), rows)", "(void)s; (void)rows", "gap"),
        ("slope", "->sigma;", "->channel.filter.S;", "known"),
        ("bank", "&s->of, mode)", "&s->of, 0u * mode)", "probable"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_seen(kind: str, right: str, wrong: str, seen: str, tmp_path: Path) -> None:
    slope = channel("a", 2, 0.05)
    given = (
        bundle_of_bank("resting 1", "float64") if kind == "bank" else bundle(slope, precision="float64", gain="full")
    )
    source = write_bundle(given, tmp_path) / "drive.c"
    text = source.read_text()
    assert text.count(right) == 1
    source.write_text(text.replace(right, wrong))
    failed = re.findall(r"^drive_a (\w+) +FAILED", made("check", cwd=tmp_path).stdout, re.M)
    assert set(seen.split()) <= set(failed)
