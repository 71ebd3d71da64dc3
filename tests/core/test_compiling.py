"""Compiled kernels are kept, found again, and made anew when anything is amiss; the program goes on without."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src" / "becalm"

PART = """
from becalm.core.compiling import compiled_part

@compiled_part
def part(x: float) -> float:
    return x + 1.0
"""

WHOLE = """
from becalm.core.compiling import compiled, save_trouble, times_compiled
from becalm.core.kernel_tiny_part import part

@compiled
def whole(x: float) -> float:
    return 2.0 * part(x)
"""

ASK = """
from becalm.core.kernel_tiny import save_trouble, times_compiled, whole
print(whole(3.0), times_compiled(whole), save_trouble(whole) is not None)
"""

FRESH, FOUND = "8.0 1 False", "8.0 0 False"

Ask = Callable[..., str]


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Copy becalm with two small kernels, one inside the other, and no cache."""
    copy = tmp_path / "site" / "becalm"
    shutil.copytree(SOURCE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "core" / "kernel_tiny_part.py").write_text(PART, encoding="utf-8")
    (copy / "core" / "kernel_tiny.py").write_text(WHOLE, encoding="utf-8")
    return copy


@pytest.fixture
def environment(package: Path, tmp_path: Path) -> dict[str, str]:
    """Lead Python to the copy, and its cache to a home of its own."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA", "XDG"))}
    home = tmp_path / "home"
    home.mkdir()
    return kept | {"PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", "HOME": str(home)}


@pytest.fixture
def ask(environment: dict[str, str], tmp_path: Path) -> Ask:
    """Run the kernel in a process of its own; return its result, times compiled, and whether keeping failed."""

    def run(before: str = "", **more: str) -> str:
        work = tmp_path / "work"
        work.mkdir(exist_ok=True)
        ran = subprocess.run(
            [sys.executable, "-c", before + ASK],
            capture_output=True, text=True, check=False, cwd=work, env=environment | more,
        )  # fmt: skip
        assert ran.returncode == 0, ran.stderr
        assert ran.stderr == ""
        assert list(work.iterdir()) == []
        return ran.stdout.strip()

    return run


def block(*folders: Path) -> None:
    """Put a file where a folder would be: not even root can write in it."""
    for folder in folders:
        folder.write_text("", encoding="utf-8")


def files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("becalm.core.kernel_tiny*.nbc"))


def test_kept_beside_the_package(ask: Ask, package: Path) -> None:
    assert [ask(), ask()] == [FRESH, FOUND]
    assert len(files(package)) == 2


def test_kept_in_the_user_s_cache_where_the_package_cannot_be_written(ask: Ask, package: Path, tmp_path: Path) -> None:
    block(package / "core" / "__pycache__")
    cache = tmp_path / "cache"
    assert [ask(XDG_CACHE_HOME=str(cache)), ask(XDG_CACHE_HOME=str(cache))] == [FRESH, FOUND]
    assert len(files(cache)) == 2


def test_goes_on_where_no_folder_can_be_written(ask: Ask, package: Path, tmp_path: Path) -> None:
    block(package / "core" / "__pycache__", tmp_path / "file")
    nowhere = {"XDG_CACHE_HOME": str(tmp_path / "file"), "NUMBA_CACHE_DIR": str(tmp_path / "file")}
    assert [ask(**nowhere), ask(**nowhere)] == [FRESH, FRESH]


def test_a_folder_that_was_named_and_cannot_be_written_is_passed_over(ask: Ask, tmp_path: Path) -> None:
    block(tmp_path / "file")
    named = str(tmp_path / "file" / "cache")
    assert [ask(NUMBA_CACHE_DIR=named), ask(NUMBA_CACHE_DIR=named)] == [FRESH, FOUND]


def test_without_a_home_no_folder_is_made(ask: Ask, package: Path) -> None:
    block(package / "core" / "__pycache__")
    homeless = "import os\nos.path.expanduser = lambda path: path\n"
    assert ask(homeless) == FRESH


def test_what_an_administrator_compiled_is_read_by_all(ask: Ask, package: Path, tmp_path: Path) -> None:
    assert ask() == FRESH
    assert ask(NUMBA_CACHE_DIR=str(tmp_path / "own")) == FOUND
    assert files(package)[0].stat().st_mode & 0o044 == 0o044


def test_goes_on_when_the_disk_is_full(ask: Ask, package: Path) -> None:
    full = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    assert ask(full) == "8.0 1 True"
    assert list((package / "core" / "__pycache__").iterdir()) == []


@pytest.mark.parametrize(
    "spoil",
    [lambda whole: whole[: len(whole) // 2], lambda whole: b"", lambda whole: whole[:-9] + b"!" + whole[-8:]],
    ids=["truncated", "empty", "one byte changed"],
)
def test_a_damaged_file_is_made_anew(ask: Ask, package: Path, spoil: Callable[[bytes], bytes]) -> None:
    assert ask() == FRESH
    for file in files(package):
        file.write_bytes(spoil(file.read_bytes()))
    assert [ask(), ask()] == [FRESH, FOUND]


def test_an_edit_of_an_inner_kernel_reaches_the_outer_one(ask: Ask, package: Path) -> None:
    assert ask() == FRESH
    before, inner = files(package), package / "core" / "kernel_tiny_part.py"
    stamp = inner.stat()
    inner.write_text(PART.replace("1.0", "5.0"), encoding="utf-8")
    os.utime(inner, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert ask() == "16.0 1 False"
    assert files(package) == before, "what is stale is overwritten, not heaped up"


def test_an_interpreter_that_may_not_compile_is_refused_on_use(environment: dict[str, str]) -> None:
    code = (
        "from becalm.core.kernel_tiny import whole\nfrom becalm.errors import UsageError\n"
        "try:\n    whole(3.0)\nexcept UsageError as cause:\n    print(cause)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment | {"NUMBA_DISABLE_JIT": "1"}
    )
    assert ran.stdout.startswith("NUMBA_DISABLE_JIT is set"), ran.stderr


def test_processes_that_compile_at_once_do_not_disturb_each_other(environment: dict[str, str], ask: Ask) -> None:
    started = [
        subprocess.Popen([sys.executable, "-c", ASK], stdout=subprocess.PIPE, text=True, env=environment)
        for _ in range(3)
    ]
    said = [process.communicate()[0].strip() for process in started]
    assert set(said) <= {FRESH, FOUND}
    assert ask() == FOUND


@pytest.mark.slow
def test_an_edit_of_an_equation_changes_the_next_result(environment: dict[str, str], package: Path) -> None:
    code = (
        "import becalm, numpy as np\nmodel = becalm.components.motion(1).to_model(step_s=1.0, noise_variance=1.0)\n"
        "print(becalm.kalman_filter(model, np.arange(9.0)).signal[-1, 0])"
    )

    def result() -> float:
        ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
        return float(ran.stdout)

    steps = package / "core" / "kernel_steps.py"
    text, equation = steps.read_text(encoding="utf-8"), "s = Q[i, j]\n"
    assert text.count(equation) == 1
    before = result()
    steps.write_text(text.replace(equation, "s = 100.0 * Q[i, j]\n"), encoding="utf-8")
    assert abs(result() - before) > 1e-3
