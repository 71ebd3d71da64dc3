"""The house keeps its budgets: file sizes, public names, a light import."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import becalm

ROOT = Path(__file__).parents[2]
ROOMS = ("src", "tests", "benchmarks", "docs")
SOURCES = sorted([*ROOT.glob("*.py"), *(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))])
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
HEAVY = ["scipy.signal", "scipy.linalg", "pyarrow", "pydantic", "matplotlib", "numpy"]


def loaded_by(code: str) -> set[str]:
    probe = f"import sys, json\n{code}\nprint(json.dumps(sorted(sys.modules)))"
    ran = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    return set(json.loads(ran.stdout.splitlines()[-1]))


def test_a_file_has_at_most_500_lines() -> None:
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES}
    assert len(lines) > 900
    assert {path: count for path, count in lines.items() if count > 500} == {}


def test_no_two_public_classes_share_a_name() -> None:
    places: dict[str, list[Path]] = {}
    for path in SOURCES:
        if ROOT / "src" in path.parents:
            for name in re.findall(r"^class ([A-Z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE):
                places.setdefault(name, []).append(path)
    assert len(places) > 500
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_public_names_are_few_and_there() -> None:
    assert len(becalm.__all__) <= 12
    assert all(getattr(becalm, name) is not None for name in becalm.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = becalm.nothing


def test_import_is_light() -> None:
    assert not loaded_by("import becalm") & set(HEAVY)


def test_help_is_light() -> None:
    asked = "ran = CliRunner().invoke(app, ['--help'])\nassert ran.exit_code == 0 and 'inspect' in ran.output"
    heavy = loaded_by(f"from typer.testing import CliRunner\nfrom becalm.cli.main import app\n{asked}")
    assert not heavy & set(HEAVY)


@pytest.mark.parametrize("module", ["becalm.core.online", "becalm.cleaning.pipeline", "becalm.files.inputs.opening"])
def test_scipy_is_loaded_by_what_needs_it_alone(module: str) -> None:
    assert "scipy" not in loaded_by(f"import {module}")


@pytest.mark.parametrize("call", ["tune(record)", "clean(record, recipe)"])
def test_scipy_is_loaded_before_threads_would(call: str) -> None:
    """Two threads that load it at once find parts of it half loaded."""
    made = """
import concurrent.futures as futures, numpy as np
from becalm import Recording, clean, tune
from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
class Pool(futures.ThreadPoolExecutor):
    def __init__(self, *args, **kwargs):
        assert "scipy.optimize" in sys.modules
        super().__init__(*args, **kwargs)
        print("a pool")
import becalm.cleaning.cleaner, becalm.cleaning.tuning
becalm.cleaning.cleaner.ThreadPoolExecutor = becalm.cleaning.tuning.ThreadPoolExecutor = Pool
record = Recording(np.random.default_rng(0).normal(size=(500, 2)), rate_hz=100.0)
one = dict(model="motion", order=1, process_noise_density=1.0, noise_std=1.0)
recipe = Recipe(tuned_on=Origin(rate_hz=100.0), channel=tuple(ChannelRecipe(name=n, **one) for n in record.names))
assert "scipy.optimize" not in sys.modules
"""
    assert "scipy.optimize" in loaded_by(made + call)


def test_configuration_names_only_paths_that_exist() -> None:
    assert all((ROOT / path).exists() for path in PYPROJECT["tool"]["pytest"]["ini_options"]["testpaths"])
    assert all((ROOT / path).exists() for path in PYPROJECT["tool"]["mypy"]["files"])


@pytest.mark.parametrize("lock", ["requirements.lock", "requirements-test.lock"])
def test_locks_hold_names_versions_and_hashes_only(lock: str) -> None:
    for line in (ROOT / lock).read_text(encoding="utf-8").splitlines():
        assert re.fullmatch(r"[a-z0-9-]+==[^\s]+( ; [^\\]+)?( \\)?|    --hash=sha256:[0-9a-f]{64}( \\)?", line), line


def test_design_names_the_rooms_that_exist() -> None:
    text = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    for path in (ROOT / "src/becalm").iterdir():
        if path.is_dir() and path.name != "__pycache__":
            assert f"  {path.name}/" in text, path.name


def test_the_command_is_installed() -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "becalm", "--help"], capture_output=True, text=True, check=True, env=os.environ
    )
    assert all(command in ran.stdout for command in ("inspect", "clean", "tune", "demo"))
