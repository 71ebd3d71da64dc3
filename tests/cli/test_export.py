"""`becalm export`: from a recipe to C that was compiled, run and compared; what cannot be is refused in a sentence."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from exported import need

Run = Callable[..., subprocess.CompletedProcess[str]]

RECIPE = """becalm_recipe = 4
mode = "causal"

[tuned_on]
rate_hz = 100.0

[[channel]]
name = "ax"
unit = "m/s^2"
model = "motion"
order = 2
process_noise_density = 6.25
noise_std = 1.0

[[channel]]
name = "load (kN)"
unit = "kN"
model = "motion"
order = 1
process_noise_density = 0.01
noise_std = 0.5

[channel.limits]
low = -50.0
high = 50.0
stuck_readings = 20

[[channel]]
name = "flag"
model = "constant"
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "bench test.toml"
    path.write_text(RECIPE, encoding="utf-8")
    return path


def test_a_recipe_becomes_c_that_passes_its_own_vectors(recipe: Path, run: Run, tmp_path: Path) -> None:
    ran = run("export", recipe, "-o", "out", "--json")
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout)
    assert [one["functions"] for one in told["channels"]] == ["bench_test_ax_*", "bench_test_load_kn_*"]
    assert told["channels"][0]["state_bytes"] == 16
    assert "flag passes unchanged, and is left out." in ran.stderr
    header = (tmp_path / "out" / "bench_test.h").read_text(encoding="utf-8")
    assert "float reading_m_per_s2, float *signal_m_per_s2" in header
    assert "float reading_kn, float *signal_kn" in header
    assert "#define BENCH_TEST_SAMPLE_RATE_UHZ 100000000UL" in header
    need("make")
    need("cc")
    made = subprocess.run(["make", "-C", tmp_path / "out", "check"], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    assert "All vectors and checks passed." in made.stdout


def test_exported_again_it_is_the_same(recipe: Path, run: Run, tmp_path: Path) -> None:
    for folder in ("one", "two"):
        assert run("export", recipe, "-o", folder, "--precision", "float64").returncode == 0
    one, two = (
        {
            path.relative_to(tmp_path / name): path.read_bytes()
            for path in (tmp_path / name).rglob("*")
            if path.is_file()
        }
        for name in ("one", "two")
    )
    assert one == two
    copies = [path for path in one if path.name == "bench_test.c"]
    assert len(copies) == 2  # one of them for Arduino
    assert one[copies[0]] == one[copies[1]]


@pytest.mark.slow
def test_a_certificate_says_what_was_run(recipe: Path, run: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(3000) / 100
    table = np.column_stack([t, 9 * np.sin(t) + rng.normal(0, 1, t.size), rng.normal(20, 0.5, t.size), np.ones(t.size)])
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header="time_s,ax (m/s^2),load (kN),flag", comments="")
    words = ["export", recipe, "-o", "out", "--verify", "--recording", "r.csv", "--channels", "load (kN)", "--json"]
    ran = run(*words)
    assert ran.returncode == 0, ran.stderr
    (drawn, recorded) = json.loads(ran.stdout)["compared"]
    assert (recorded["record"], recorded["rows"]) == ("the recording", 3000)
    assert min(drawn["snr_db"], recorded["snr_db"]) >= 120
    page = (tmp_path / "out" / "certificate.md").read_text(encoding="utf-8")
    assert "| `-O3 -ffast-math` | all passed |" in page
    assert recorded["error_row"] >= recorded["first_row"] >= 0
    greatest = f"{recorded['error']:.2g} of the greatest signal, in row {recorded['error_row']} |"
    assert f"| load (kN) | the recording | 3000 | becalm's stream | {greatest}" in page


REFUSED = {
    "no such form": (["--to", "rust"], "There is no export to 'rust'; write --to c, sos, json or scipy."),
    "no such precision": (["--precision", "half"], "There is no precision 'half'; write float32, float64 or q31."),
    "no such gain": (["--gain", "some"], "There is no gain 'some'; write auto, settled or full."),
    "no such channel": (["--channels", "az"], "The recipe has no channel 'az'; it has ax, load (kN), flag."),
    "a range without an end": (["--range", "ax=5"], "write NAME=LOW:HIGH in the channel's unit: ax=-20:20."),
    "a range of nothing": (["--range", "ax=5:5"], "--range ax=5:5 is not a range"),
    "two ranges of a channel": (
        ["--range", "ax=0:5", "--range", "ax=0:6"],
        "ax=0:6 differs from an earlier one for ax",
    ),
    "a range of no channel": (["--range", "az=0:5"], "the recipe has no channel 'az'"),
    "a form with a precision": (["--to", "sos", "--precision", "float32"], "With --to sos only --channels is possible"),
    "unfiltered": (["--channels", "flag"], "No channel of the recipe is filtered, so there is nothing to export."),
    "q31 without a range": (["--precision", "q31", "--channels", "ax"], "give --range"),
}


@pytest.mark.parametrize(("words", "says"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_is_refused(words: list[str], says: str, recipe: Path, run: Run, tmp_path: Path) -> None:
    ran = run("export", recipe, "-o", "out", *words)
    assert ran.returncode == 2, ran.stderr
    assert says in ran.stderr
    assert "Traceback" not in ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["bench test.toml"]


def test_it_is_not_written_over_the_recipe_nor_over_a_file(recipe: Path, run: Run, tmp_path: Path) -> None:
    assert "is the recipe itself" in run("export", recipe, "-o", recipe).stderr
    (tmp_path / "taken").write_text("mine", encoding="utf-8")
    ran = run("export", recipe, "-o", "taken")
    assert ran.returncode == 2
    assert (tmp_path / "taken").read_text(encoding="utf-8") == "mine"


def test_sections_filter_as_the_stream_does(recipe: Path, run: Run, tmp_path: Path) -> None:
    from scipy.signal import sosfilt, sosfilt_zi

    from becalm.cleaning.recipes.recipe import Recipe
    from becalm.cleaning.streaming.stream import StreamCleaner

    for form in ("sos", "json", "scipy"):
        assert run("export", recipe, "--to", form, "-o", f"r.{form}").returncode == 0
    sections = json.loads((tmp_path / "r.sos").read_text(encoding="utf-8"))
    numbers = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert numbers["channels"]["ax"]["sos"] == sections["ax"]
    module: dict[str, object] = {}
    exec(compile((tmp_path / "r.scipy").read_text(encoding="utf-8"), "r.scipy", "exec"), module)
    rng = np.random.default_rng(2)
    z = np.column_stack([rng.normal(3, 1, 20_000), rng.normal(7, 0.5, 20_000), np.ones(20_000)])
    stream = StreamCleaner(Recipe.load(recipe), 0.01).push(z, np.ones(len(z))).signal
    for at, name in enumerate(("ax", "load (kN)")):
        sos = np.array(sections[name])
        filtered = sosfilt(sos, z[:, at], zi=sosfilt_zi(sos) * z[0, at])[0]
        np.testing.assert_allclose(filtered[10_000:], stream[10_000:, at], rtol=1e-10)
        np.testing.assert_array_equal(module["clean"](name, z[:, at]), filtered)  # type: ignore[operator]


def test_files_that_no_export_wrote_stay_and_an_old_certificate_goes(recipe: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "main.c").write_text("mine", encoding="utf-8")
    ran = run("export", recipe, "-o", "mine")
    assert ran.returncode == 2
    assert "has files that no export wrote" in ran.stderr
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["main.c"]
    assert run("export", recipe, "-o", "out").returncode == 0
    (tmp_path / "out" / "certificate.md").write_text("of another", encoding="utf-8")
    assert run("export", recipe, "-o", "out").returncode == 0
    assert not (tmp_path / "out" / "certificate.md").exists()


def test_files_of_the_library_that_an_older_export_needed_go(recipe: Path, run: Run, tmp_path: Path) -> None:
    """A compiler that takes all that lies there, as Arduino's does, would stumble on them."""
    assert run("export", recipe, "-o", "out", "--gain", "full").returncode == 0
    assert (tmp_path / "out/native/filter.c").exists()
    mine = tmp_path / "out/native/mine.txt"
    mine.write_text("a person's own", encoding="utf-8")
    assert run("export", recipe, "-o", "out", "--gain", "settled").returncode == 0
    assert not list((tmp_path / "out").rglob("filter.[ch]"))
    assert mine.exists()
