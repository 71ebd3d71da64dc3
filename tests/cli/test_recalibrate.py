"""A wrong sensitivity mended afterwards is what cleaning again with the right one gives; else it is refused."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from becalm.core.arrays import Floats
from becalm.files.inputs.opening import close
from becalm.files.outputs.writing import open_output
from becalm.files.registry import read_tables
from forked import command

Run = Callable[..., subprocess.CompletedProcess[str]]
OLD = """
[[sensor]]
kind = "accelerometer"
channel = "a"
raw_unit = "V"
unit = "g"
sensitivity_mv = 100.0
sensitivity_uncertainty_mv = 4.0
zero_uncertainty = 0.02
"""
NEW = OLD.replace("100.0", "80.0").replace("4.0", "0.8").replace("0.02", "0.01") + "bias_mv = 20.0\n"


@pytest.fixture(scope="module")
def cleaned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clean 600 rows with two spikes by the old sensors; return the folder."""
    folder = tmp_path_factory.mktemp("cleaned")
    rng, t = np.random.default_rng(3), np.arange(600) / 100
    volts = 0.05 * np.sin(t) + np.cumsum(rng.normal(0, 1e-4, 600)) + rng.normal(0, 2e-3, 600)
    volts[[100, 400]] += 0.5
    path = folder / "raw.csv"
    rows = "".join(f"{at:.2f},{v:.9f},{k}\n" for k, (at, v) in enumerate(zip(t, volts, strict=True)))
    path.write_text("time_s,a (V),row\n" + rows, encoding="utf-8")
    (folder / "old.toml").write_text(OLD, encoding="utf-8")
    (folder / "new.toml").write_text(NEW, encoding="utf-8")
    words = ["clean", "raw.csv", "-o", "clean.csv", "--channels", "a", "--sensors", "old.toml"]
    ran = command(words, folder, {**os.environ, "COLUMNS": "200"})
    assert ran.returncode in (0, 4), ran.stderr
    return folder


@pytest.fixture
def clean(cleaned: Path, tmp_path: Path) -> Path:
    """Return the readings, beside a copy of all that was made of them."""
    shutil.copytree(cleaned, tmp_path, dirs_exist_ok=True)
    return tmp_path / "raw.csv"


def columns(path: Path) -> Floats:
    return np.asarray(np.genfromtxt(path, delimiter=",", skip_header=1))


def test_it_is_what_cleaning_again_gives(clean: Path, run: Run, tmp_path: Path) -> None:
    ran = run("recalibrate", "clean.csv", "-o", "mended.csv", "--from", "old.toml", "--to", "new.toml")
    assert ran.returncode == 0, ran.stderr
    assert "a (g): times 1.25, then minus 0.25." in ran.stderr
    run("clean", clean, "-o", "again.csv", "--channels", "a", "--sensors", "new.toml")
    mended, again = tmp_path / "mended.csv", tmp_path / "again.csv"
    assert mended.read_text().splitlines()[0] == again.read_text().splitlines()[0]
    found, expected = columns(mended), columns(again)
    np.testing.assert_array_equal(found[:, [0, 3]], expected[:, [0, 3]])
    np.testing.assert_allclose(found[:, 1], expected[:, 1], atol=1e-3 * np.median(expected[:, 2]))
    np.testing.assert_allclose(found[:, 2], expected[:, 2], rtol=1e-3)
    assert not (tmp_path / "mended.csv.recipe.toml").exists()


def test_a_recipe_of_an_earlier_output_is_not_taken_for_the_new_ones(clean: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "mended.csv.recipe.toml").write_text("of another day", encoding="utf-8")
    ran = run("recalibrate", "clean.csv", "-o", "mended.csv", "--from", "old.toml", "--to", "new.toml")
    assert ran.returncode == 2
    assert "mended.csv.recipe.toml is the recipe of an earlier output; remove it" in ran.stderr
    assert not (tmp_path / "mended.csv").exists()


def test_there_and_back_is_as_before(clean: Path, run: Run, tmp_path: Path) -> None:
    run("recalibrate", "clean.csv", "-o", "mended.csv", "--from", "old.toml", "--to", "new.toml")
    recipe = (tmp_path / "clean.csv.recipe.toml").read_text()
    told = recipe.replace("relative_std = 0.02", "relative_std = 0.005").replace(
        "offset_std = 0.01", "offset_std = 0.005"
    )
    assert told != recipe
    (tmp_path / "mended.csv.recipe.toml").write_text(told, encoding="utf-8")
    ran = run("recalibrate", "mended.csv", "-o", "back.csv", "--from", "new.toml", "--to", "old.toml")
    assert ran.returncode == 0, ran.stderr
    np.testing.assert_allclose(columns(tmp_path / "back.csv"), columns(tmp_path / "clean.csv"), rtol=1e-6, atol=1e-8)


def test_each_time_of_a_file_is_mended_by_its_own_sensors(run: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    with open_output(tmp_path / "raw.h5") as out:
        for group, channel, rate_hz in (("fast", "a", 100.0), ("slow", "b", 10.0)):
            fields = [pa.field("time_s", pa.float64()), pa.field(channel, pa.float64(), metadata={b"unit": b"V"})]
            walk = np.cumsum(rng.normal(0, 1e-3, 300)) + rng.normal(0, 2e-3, 300)
            schema = pa.schema(fields, {"becalm.group": group})
            out.write(pa.table([pa.array(np.arange(300) / rate_hz), pa.array(walk)], schema=schema))
    (tmp_path / "old.toml").write_text(OLD + OLD.replace('"a"', '"b"'), encoding="utf-8")
    (tmp_path / "new.toml").write_text(NEW + OLD.replace('"a"', '"b"'), encoding="utf-8")
    ran = run("clean", "raw.h5", "-o", "clean.h5", "--sensors", "old.toml")
    assert ran.returncode in (0, 4), ran.stderr
    ran = run("recalibrate", "clean.h5", "-o", "mended.h5", "--from", "old.toml", "--to", "new.toml")
    assert ran.returncode == 0, ran.stderr
    ran = run("recalibrate", "clean.h5", "-o", "mended.csv", "--from", "old.toml", "--to", "new.toml")
    assert ran.returncode == 2
    assert "channels at 2 times" in ran.stderr
    was, now = (read_tables(tmp_path / name) for name in ("clean.h5", "mended.h5"))
    try:
        assert [table.group for table in now] == ["fast", "slow"]
        before, after = ([next(table.blocks(table.names)) for table in tables] for tables in (was, now))
    finally:
        close((*was, *now))
    np.testing.assert_allclose(after[0]["a"], 1.25 * np.asarray(before[0]["a"]) - 0.25, rtol=1e-12)
    for name in ("time_s", "b", "b_sigma"):
        np.testing.assert_allclose(after[1][name], before[1][name], rtol=1e-9)


BRIDGE = '[[sensor]]\nkind = "bridge"\nchannel = "a"\nraw_unit = "mV/V"\nconfiguration = "full I"\ngauge_factor = 2\n'
TRIAXIAL = '[[sensor]]\nkind = "triaxial"\nchannels = ["a", "b", "c"]\nraw_unit = "V"\nunit = "g"\n'
TRIAXIAL += "sensitivity_mv = [1, 1, 1]\n"
MISTAKES = {
    "not linear": (BRIDGE, BRIDGE, "is not linear in its readings. Clean the readings again"),
    "axes": (TRIAXIAL, TRIAXIAL, "are calibrated together"),
    "another sensor": (OLD, OLD.replace('"a"', '"b"'), "The sensor of a is in one of --from and --to only"),
    "other units": (OLD, NEW.replace('"V"', '"mV"'), "write both in the same units"),
    "full scale": (OLD, NEW + "lowest_reading = -5\nhighest_reading = 5\n", "has another full scale"),
    "not cleaned": (OLD.replace('"a"', '"row"'), OLD.replace('"a"', '"row"'), "'row' was not cleaned"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_needs_the_readings_is_refused(mistake: str, clean: Path, run: Run, tmp_path: Path) -> None:
    assert clean.exists()
    old, new, sentence = MISTAKES[mistake]
    (tmp_path / "old.toml").write_text(old, encoding="utf-8")
    (tmp_path / "new.toml").write_text(new, encoding="utf-8")
    ran = run("recalibrate", "clean.csv", "-o", "mended.csv", "--from", "old.toml", "--to", "new.toml")
    assert ran.returncode == 2
    assert sentence in ran.stderr
    assert "Traceback" not in ran.stderr
    assert not (tmp_path / "mended.csv").exists()


@pytest.mark.parametrize(("words", "sentence"), [("--split", "has parts of 'a (g)'"), ("--robust", "several modes")])
def test_a_filter_that_is_more_than_size_and_zero_is_refused(words: str, sentence: str, clean: Path, run: Run) -> None:
    ran = run("clean", clean, "-o", "clean.csv", "--channels", "a", "--sensors", "old.toml", words)
    assert ran.returncode in (0, 4), ran.stderr
    ran = run("recalibrate", "clean.csv", "-o", "mended.csv", "--from", "old.toml", "--to", "new.toml")
    assert ran.returncode == 2
    assert sentence in ran.stderr


def test_a_unit_that_only_the_recipe_tells_is_seen(clean: Path, run: Run, tmp_path: Path) -> None:
    clean.write_text(clean.read_text(encoding="utf-8").replace("a (V)", "a", 1), encoding="utf-8")
    run("clean", clean, "-o", "mg.csv", "--channels", "a", "--sensors", "old.toml", "--unit", "a=m/s^2")
    assert (tmp_path / "mg.csv").read_text(encoding="utf-8").startswith("time_s,a,a_sigma,")
    ran = run("recalibrate", "mg.csv", "-o", "mended.csv", "--from", "old.toml", "--to", "new.toml")
    assert ran.returncode == 2
    assert "'a' is in m/s^2, but --from converts its readings to g" in ran.stderr
    assert not (tmp_path / "mended.csv").exists()


def test_without_its_recipe_nobody_knows_how_it_was_cleaned(clean: Path, run: Run, tmp_path: Path) -> None:
    ran = run("recalibrate", clean, "-o", "mended.csv", "--from", "old.toml", "--to", "new.toml")
    assert ran.returncode == 2
    assert "raw.csv.recipe.toml does not exist" in ran.stderr
