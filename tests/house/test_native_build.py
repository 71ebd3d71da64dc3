"""The filter in C is compiled when becalm is built, without a warning; where it cannot be, a sentence says so."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, cast

import pytest

import hatch_build

ROOT = Path(__file__).parents[2]
STRICT = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the sources: three are compiled, not optimised; test_uplot_build.py compiles all."""
    monkeypatch.setattr(hatch_build, "SOURCES", ("channel.c", "filter.c", "clock.c"))
    monkeypatch.setattr(hatch_build, "C_FLAGS", ("-std=c99", "-O0", "-ffp-contract=off", "-fPIC"))
    monkeypatch.setattr(hatch_build, "MORE_FLAGS", ())
    shutil.copytree(ROOT / hatch_build.NATIVE, tmp_path / hatch_build.NATIVE)
    (tmp_path / hatch_build.NATIVE / hatch_build.KERNEL).unlink()
    return tmp_path


def files(project: Path) -> set[str]:
    return {path.name for path in (project / hatch_build.NATIVE).iterdir()}


def test_it_is_compiled_beside_its_sources_and_again_after_an_edit(project: Path) -> None:
    before, kernel = files(project), project / hatch_build.NATIVE / hatch_build.KERNEL
    hatch_build.compile_kernel(project)
    assert files(project) - before == {hatch_build.KERNEL}
    first = kernel.stat().st_mtime_ns
    hatch_build.compile_kernel(project)
    assert kernel.stat().st_mtime_ns == first
    edited = project / hatch_build.NATIVE / "gate.h"
    os.utime(edited, ns=(first + 10**9, first + 10**9))
    hatch_build.compile_kernel(project)
    assert kernel.stat().st_mtime_ns > first


def test_a_compiler_that_fails_says_why_and_leaves_nothing(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = files(project)
    with (project / hatch_build.NATIVE / "channel.c").open("a", encoding="utf-8") as source:
        source.write("no C\n")
    with pytest.raises(hatch_build.BuildError, match=r"was not compiled \(.*error.*\)\. Install a C compiler"):
        hatch_build.compile_kernel(project)
    monkeypatch.setenv("CC", "/nowhere/cc")
    with pytest.raises(hatch_build.BuildError, match=r"No such file.*'apt-get install gcc'"):
        hatch_build.compile_kernel(project)
    assert files(project) == before


def test_without_a_compiler_that_of_pypi_is_asked_for(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", os.devnull)
    monkeypatch.delenv("CC", raising=False)
    assert hatch_build.own_compiler() == []
    stand_in = project / "ziglang.py"
    stand_in.write_text("import sys\nsys.exit(' '.join(['asked', *sys.argv[1:3]]))\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(project))
    with pytest.raises(hatch_build.BuildError, match=r"asked cc -mcpu=baseline"):
        hatch_build.compile_kernel(project)


STAND_IN = """
import sys
from pathlib import Path
words = sys.argv[1:]
Path(words[words.index("-o") + 1]).write_text(" ".join(words))
if "-MF" in words:
    Path(words[words.index("-MF") + 1]).write_text("object: " + words[words.index("-c") - 1])
"""


@pytest.mark.parametrize("platform", hatch_build.PLATFORMS)
def test_a_wheel_for_another_machine_has_a_filter_of_its_own(
    project: Path, monkeypatch: pytest.MonkeyPatch, platform: str
) -> None:
    before = files(project)
    (project / "ziglang.py").write_text(STAND_IN, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(project))
    kernel = hatch_build.kernel_for(project, platform)
    assert kernel.name == ("kernel.dll" if platform == "win_amd64" else "kernel.so")
    assert f"-target {hatch_build.PLATFORMS[platform]}" in kernel.read_text(encoding="utf-8")
    assert files(project) == before


@pytest.mark.parametrize(("version", "tag"), [("standard", "py3-none-win_amd64"), ("editable", "py3-none-linux")])
def test_a_wheel_holds_the_filter_of_its_platform_and_an_editable_install_none(
    project: Path, monkeypatch: pytest.MonkeyPatch, version: str, tag: str
) -> None:
    (project / "ziglang.py").write_text(STAND_IN, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(project))
    monkeypatch.setenv(hatch_build.PLATFORM, "win_amd64")
    monkeypatch.setattr(hatch_build, "provide", lambda root: None)
    monkeypatch.setattr(hatch_build, "compile_kernel", lambda root: None)
    nothing, built = cast(Any, None), {"force_include": dict[str, str]()}
    hatch_build.BuildHook(str(project), {}, nothing, nothing, "", "wheel").initialize(version, built)
    assert str(cast(Any, built)["tag"]).startswith(tag)
    assert list(built["force_include"].values()) == (["becalm/native/kernel.dll"] if version == "standard" else [])


def test_a_platform_that_is_none_is_refused_with_those_there_are(project: Path) -> None:
    with pytest.raises(hatch_build.BuildError, match=r"BECALM_PLATFORM is 'amiga'; it may be manylinux.*win_amd64"):
        hatch_build.kernel_for(project, "amiga")


@pytest.mark.parametrize("source", hatch_build.SOURCES)
@pytest.mark.parametrize(
    ("compiler", "flags"),
    [
        ("clang", ("-O0",)),  # its warnings do not depend on optimisation
        pytest.param("gcc", ("-O1", "-ftree-vrp"), marks=pytest.mark.slow),  # warns as -O2 does, in half the time
    ],
)
def test_no_compiler_warns(compiler: str, flags: tuple[str, ...], source: str, tmp_path: Path) -> None:
    """gcc sees more when it optimises: values that are not set, and ends of arrays."""
    if not shutil.which(compiler):
        pytest.skip(f"{compiler} is not installed")
    place = str(ROOT / hatch_build.NATIVE / source)
    command = [compiler, *hatch_build.C_FLAGS, *flags, *STRICT, "-c", place, "-o", str(tmp_path / "object")]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
