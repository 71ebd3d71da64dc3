"""The filter in C under AddressSanitizer and UndefinedBehaviorSanitizer, on random cases from Hypothesis.

gcc compiles the sources of `becalm/native` with both sanitizers, a copy of the package loads them, and Hypothesis draws
cases until the time is over: recipes of orders 1 to 5 with tones, coloured noise, gates, limits, modes and uncertain
times; models of one to four channels; clocks; readings with holes, NaN, infinities and numbers up to 1e308; sampling
intervals of any length; cuts into blocks; filters that are saved, damaged in some bytes, and restored; records that are
tuned. A finding of a sanitizer ends the campaign; so does a case whose blocks do not give bitwise the result of the
whole.

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
    """Copy the package into a folder, with the filter compiled with sanitizers; return the folder to import it from."""
    package = folder / "becalm"
    shutil.copytree(ROOT / "src" / "becalm", package, ignore=shutil.ignore_patterns("__pycache__", "kernel.*[ol]"))
    sources = [str(package / "native" / name) for name in BUILD["SOURCES"]]
    command = ["gcc", *BUILD["C_FLAGS"], *FLAGS, "-shared", *sources, "-o", str(package / "native" / "kernel.so")]
    subprocess.run([*command, "-fno-var-tracking-assignments", "-lm"], check=True)
    return folder


def library(name: str) -> str:
    """Return the path of a library of gcc."""
    ran = subprocess.run(["gcc", f"-print-file-name={name}"], check=True, capture_output=True, text=True)
    return ran.stdout.strip()


def campaign(folder: Path, minutes: float, seed: int) -> dict[str, int]:
    """Run cases until the time is over; return the number of cases of each kind.

    Raises
    ------
    SystemExit
        After a finding, with a message that includes the case.
    """
    results, case = folder / "counts.json", folder / "case.txt"
    own = {
        "PYTHONPATH": str(compiled(folder)),
        "LD_PRELOAD": f"{library('libasan.so')} {library('libubsan.so')}",
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "PYTHONMALLOC": "malloc",
        "OPENBLAS_NUM_THREADS": "1",
    }
    words = [sys.executable, str(DRAWING), str(results), str(case), str(seed), str(time.time() + 60 * minutes)]
    ran = subprocess.run(words, env=os.environ | own, capture_output=True, text=True, check=False)
    if ran.returncode:
        sys.exit(f"{ran.stdout}\n{ran.stderr}\nThe case: {case.read_text(encoding='utf-8')}")
    counts: dict[str, int] = json.loads(results.read_text(encoding="utf-8"))
    return counts


def main() -> None:
    """Run a campaign, and print the number of cases; with -o, write them as a page."""
    parser: argparse.ArgumentParser = page_parser(__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="how long")
    parser.add_argument("--seed", type=int, default=0, help="of the first cases")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        counts = campaign(Path(folder), arguments.minutes, arguments.seed)
    rows = "".join(f"| {kind} | {count} |\n" for kind, count in sorted(counts.items()))
    text = f"{arguments.minutes:g} minutes, no finding.\n\n| cases | |\n|---|---|\n{rows}"
    publish("The filter in C, watched", __doc__, text, arguments.output)


if __name__ == "__main__":
    main()
