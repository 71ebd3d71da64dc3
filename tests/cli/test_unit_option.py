"""Units on the command line: asked for, told, and those of a recipe."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]
G0 = 9.80665


@pytest.fixture
def logs(tmp_path: Path) -> tuple[Path, Path]:
    """Write the same 400 rows in g, and in m/s^2 with another header."""
    rng, t = np.random.default_rng(8), np.arange(400) / 100
    a, u = np.sin(t) + rng.normal(0, 0.1, t.size), np.cumsum(rng.normal(0, 0.1, t.size)) + rng.normal(0, 0.2, t.size)
    in_g, in_si = tmp_path / "g.csv", tmp_path / "si.csv"
    for path, header, scale in ((in_g, "a x (g)", 1.0), (in_si, "a x [m/s2]", G0)):
        table = np.column_stack([t, scale * a, u])
        np.savetxt(path, table, delimiter=",", header=f"time_s,{header},bridge", comments="", fmt="%.15g")
    return in_g, in_si


def signal(path: Path, column: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.genfromtxt(path, delimiter=",", skip_header=1)[:, column]


def test_a_channel_is_cleaned_in_the_unit_asked_for(logs: tuple[Path, Path], run: Run, tmp_path: Path) -> None:
    ran = run("clean", logs[0], "-o", "out.csv", "--unit", "a x=m/s^2", "--unit", "bridge=mV/V", "--json")
    assert ran.returncode in (0, 4), ran.stderr
    told = {channel["name"]: channel["unit"] for channel in json.loads(ran.stdout)["channels"]}
    assert told == {"a x (m/s^2)": "m/s^2", "bridge": "mV/V"}
    assert "--unit: 'a x (g)' is converted from g to m/s^2 (times 9.80665)." in ran.stderr
    assert "the file has no unit for 'bridge'; mV/V is assumed." in ran.stderr
    plain = run("clean", logs[0], "-o", "plain.csv")
    assert plain.returncode == ran.returncode
    for column in (1, 2):  # signal and sigma
        expected = G0 * signal(tmp_path / "plain.csv", column)
        np.testing.assert_allclose(signal(tmp_path / "out.csv", column), expected, rtol=1e-5)
    again = run("clean", logs[0], "-o", "again.csv", "--recipe", "out.csv.recipe.toml", "--unit", "bridge=mV/V")
    assert again.returncode == ran.returncode, again.stderr
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()


def test_a_recipe_in_other_units_converts_by_itself(logs: tuple[Path, Path], run: Run, tmp_path: Path) -> None:
    in_g, in_si = logs
    assert run("tune", in_si, "-o", "si.toml").returncode == 0
    own, other = (run("clean", path, "-o", f"{path.stem}.out.csv", "--recipe", "si.toml") for path in (in_si, in_g))
    assert own.returncode == other.returncode
    said = [line for line in other.stderr.splitlines() if line.startswith("The recipe")]
    assert said == ["The recipe: 'a x (g)' is converted from g to m/s^2 (times 9.80665)."]
    assert "converted" not in own.stderr
    assert (tmp_path / "g.out.csv").read_text().startswith("time_s,a x [m/s2],a x [m/s2]_sigma")
    np.testing.assert_allclose(signal(tmp_path / "g.out.csv", 1), signal(tmp_path / "si.out.csv", 1), rtol=1e-9)


def test_a_recipe_that_cannot_be_converted_is_refused(logs: tuple[Path, Path], run: Run, tmp_path: Path) -> None:
    assert run("tune", logs[1], "-o", "si.toml").returncode == 0
    recipe = tmp_path / "si.toml"
    recipe.write_text(recipe.read_text().replace('unit = "m/s^2"', 'unit = "V"'))
    ran = run("clean", logs[0], "-o", "out.csv", "--recipe", "si.toml")
    assert ran.returncode == 2
    assert "The recipe asks for 'a x (g)' in V: 'g' is a unit of acceleration, 'V' of voltage" in ran.stderr
    assert "becalm tune" in ran.stderr
    recipe.write_text(recipe.read_text().replace('unit = ""', 'unit = "mV"').replace('unit = "V"', 'unit = "g"'))
    ran = run("clean", logs[0], "-o", "out.csv", "--recipe", "si.toml")
    assert ran.returncode == 2
    assert "--unit 'bridge=mV'" in ran.stderr
    assert not (tmp_path / "out.csv").exists()


def test_the_other_commands_take_units(logs: tuple[Path, Path], run: Run) -> None:
    in_g, in_si = logs
    shown = run("inspect", in_g, "--unit", "a x=mg", "--json")
    assert json.loads(shown.stdout)["columns"][1]["name"] == "a x (mg)"
    found = run("tune", in_g, "-o", "r.toml", "--unit", "a x=mg", "--channels", "a x", "--json")
    assert json.loads(found.stdout)["channel"][0]["unit"] == "mg"
    noise = run("noise", in_g, "--unit", "a x=mg", "--channels", "a x", "--json")
    assert json.loads(noise.stdout)["channels"][0]["unit"] == "mg"
    compared = run("compare", in_g, "--truth", in_si, "--unit", "a x=mg", "--channels", "a x", "--json")
    (channel,) = json.loads(compared.stdout)["channels"]
    assert (channel["name"], channel["unit"]) == ("a x (mg)", "mg")
    assert channel["filters"][0]["rms_error"] == pytest.approx(100, rel=0.1)  # what becalm takes off: the noise, in mg
    for ran in (found, noise, compared):
        assert "'a x (g)' is converted from g to mg (times 1000)." in ran.stderr
    assert "The recording: 'a x [m/s2]' is converted from m/s^2 to mg" in compared.stderr


MISTAKES = {
    "no unit": (["--unit", "bridge"], "--unit bridge is not NAME=UNIT; write a channel and its unit"),
    "no name": (["--unit", "=V"], "is not NAME=UNIT"),
    "twice": (["--unit", "bridge=V", "--unit", "bridge=mV"], "--unit names 'bridge' twice"),
    "unknown": (["--unit", "a x=furlong"], "'furlong' is not a unit that becalm can convert; write one as V"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_sentences(logs: tuple[Path, Path], run: Run, tmp_path: Path, mistake: str) -> None:
    words, sentence = MISTAKES[mistake]
    ran = run("clean", logs[0], "-o", "out.csv", *words)
    assert ran.returncode == 2
    assert sentence in ran.stderr
    assert "Traceback" not in ran.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["g.csv", "si.csv"]


def test_pint_is_loaded_for_conversions_only(logs: tuple[Path, Path], tmp_path: Path) -> None:
    command = ["clean", str(logs[0]), "-o", str(tmp_path / "out.csv")]
    probe = "print('pint' in sys.modules, 'becalm.cleaning.cleaner' in sys.modules, file=sys.stderr)"
    code = "import sys\nfrom becalm.cli.main import app\n"
    for words in ([], ["--unit", "a x=mg"]):
        code += f"try:\n    app({[*command, *words]!r})\nexcept SystemExit:\n    {probe}\n"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    told = [line for line in ran.stderr.splitlines() if line.endswith((" True", " False"))]
    assert told == ["False True", "True True"]
