"""The filter in C under AddressSanitizer and UndefinedBehaviorSanitizer, on what Hypothesis draws.

gcc compiles the sources of `becalm/native` with both, a copy of the package loads them, and until the time is up
Hypothesis draws cases: recipes of orders 1 to 5 with tones, coloured noise, gates, limits, modes and uncertain times;
models of one to four channels; clocks; readings with holes, NaN, infinities and numbers up to 1e308, steps of any
length, cuts into blocks, filters that are saved, damaged byte by byte, and restored; records that are tuned.
A finding of a sanitizer ends the campaign; so does a case whose blocks give other bits than the whole.

Run: python benchmarks/sanitized.py [-o docs/sanitized.md] [--minutes 60] [--seed N]
"""

from __future__ import annotations

import argparse
import json
import os
import runpy
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pages import page_parser, publish

ROOT = Path(__file__).parents[1]
DRAWING = Path(__file__).with_name("sanitized_cases.py")
BUILD = runpy.run_path(str(ROOT / "hatch_build.py"), run_name="hatch_build")
FLAGS = ("-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")


def compiled(folder: Path) -> Path:
    """Copy the package into a folder, with a filter that is watched; return where it is imported from."""
    package = folder / "becalm"
    shutil.copytree(ROOT / "src" / "becalm", package, ignore=shutil.ignore_patterns("__pycache__", "kernel.*[ol]"))
    sources = [str(package / "native" / name) for name in BUILD["SOURCES"]]
    command = ["gcc", *BUILD["C_FLAGS"], *FLAGS, "-shared", *sources, "-o", str(package / "native" / "kernel.so")]
    subprocess.run([*command, "-fno-var-tracking-assignments", "-lm"], check=True)
    return folder


def library(name: str) -> str:
    """Return where gcc has a library."""
    told = subprocess.run(["gcc", f"-print-file-name={name}"], check=True, capture_output=True, text=True)
    return told.stdout.strip()


def campaign(folder: Path, minutes: float, seed: int) -> dict[str, int]:
    """Run cases until the time is up; return how many of each kind there were.

    Raises
    ------
    SystemExit
        If there was a finding; it is printed, with the case that it came of.
    """
    told, case = folder / "counts.json", folder / "case.txt"
    own = {
        "PYTHONPATH": str(compiled(folder)),
        "LD_PRELOAD": f"{library('libasan.so')} {library('libubsan.so')}",
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "PYTHONMALLOC": "malloc",
        "OPENBLAS_NUM_THREADS": "1",
    }
    words = [sys.executable, str(DRAWING), str(told), str(case), str(seed), str(time.time() + 60 * minutes)]
    ran = subprocess.run(words, env=os.environ | own, capture_output=True, text=True, check=False)
    if ran.returncode:
        sys.exit(f"{ran.stdout}\n{ran.stderr}\nThe case: {case.read_text(encoding='utf-8')}")
    counts: dict[str, int] = json.loads(told.read_text(encoding="utf-8"))
    return counts


def main() -> None:
    """Run a campaign, and say what it ran; with -o, write it as a page."""
    parser: argparse.ArgumentParser = page_parser(__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="how long")
    parser.add_argument("--seed", type=int, default=0, help="of the first cases")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        counts = campaign(Path(folder), given.minutes, given.seed)
    rows = "".join(f"| {kind} | {count} |\n" for kind, count in sorted(counts.items()))
    text = f"{given.minutes:g} minutes, no finding.\n\n| cases | |\n|---|---|\n{rows}"
    publish("The filter in C, watched", __doc__, text, given.output)


if __name__ == "__main__":
    main()
