"""becalm's filters compared with copying, SciPy and other Kalman libraries, in nanoseconds a sample.

float64, one thread, all in one process. The rivals of a job take turns; medians of seven turns are
given, of wall-clock and of CPU time: if they differ, the machine had other work. N is the number of
time steps of one call, in all records of a batch; slow libraries get fewer. The ratio is that of
wall-clock times, rival over becalm: above 1, becalm is faster. In the rows on growth, it is the ratio to the
smallest record. "differs" is the largest difference from becalm's results, relative to the largest value; with
more than 1e-6 a rival would not do the same job. Models have x0 and P0, and a library that returns states returns
all of them, from the first reading on. statsmodels and dynamax get their readings in units of the
noise, and statsmodels a smaller tolerance; with their defaults, both are wrong on the gyroscope's small numbers.

The requirements ("asked") were set before the work, from prototypes on a machine whose memory was faster relative to
its processor. If one is not reached, look at the rows of copying first: on this machine copying into new arrays
is less than five times as fast as `lfilter`, and filling arrays in parallel costs more than one after the other.

Further measurements are listed in [Measured](measured.md).

Run: pip install 'becalm[bench]', then python benchmarks/peers.py [-o docs/benchmarks.md]
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pages import page_parser, publish

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "JAX_PLATFORMS": "cpu",
}
LIBRARIES = ("becalm", "numpy", "scipy")
"""Libraries that becalm uses; their versions are shown before those of the rivals."""


def use_one_thread() -> None:
    """Restart this program with one thread per library, unless it has that environment already."""
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **ONE_THREAD})


def processor() -> str:
    """Return the model of the processor."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()


def table(jobs: Sequence[str], quick: bool, long: bool) -> tuple[str, bool]:
    """Measure; return the table and whether all rivals agree with becalm."""
    from peers_adapters import BATCH_PEERS, PEERS, installed  # imports numpy: after use_one_thread
    from peers_jobs import FULL, JOBS, QUICK

    scale = QUICK if quick else FULL
    if long:
        scale = replace(scale, growth=(*scale.growth, 10**8))
    unknown = sorted(set(jobs) - set(JOBS))
    if unknown:
        raise SystemExit(f"No job is called {', '.join(unknown)}; there are {', '.join(JOBS)}.")
    rows = []
    for name in jobs or JOBS:
        print(f"{name} ...", file=sys.stderr, flush=True)
        rows += JOBS[name](scale)
    packages = sorted(
        {package for peer in (*PEERS, *BATCH_PEERS) for package in (peer.package, peer.needs)} - {"numpy"}
    )
    versions = [f"{name} {installed(name)}" for name in (*LIBRARIES, *packages) if installed(name)]
    absent = [name for name in packages if not installed(name)]
    lines = [
        f"{processor()}, {os.cpu_count()} cores; Python {platform.python_version()}; {', '.join(versions)}.",
        "",
        *(
            [f"Not installed and left out: {', '.join(absent)}; `pip install 'becalm[bench]'` brings them.", ""]
            * bool(absent)
        ),
        "| job | rival | N | ns a sample | CPU ns | ratio to becalm | asked | reached | differs |",
        "|---|---|---|---|---|---|---|---|---|",
        *(row.as_markdown() for row in rows),
        "",
    ]
    return "\n".join(lines), all(row.agrees for row in rows)


def main() -> None:
    """Print the table; with -o, write it as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("jobs", nargs="*", help="names of jobs (gyroscope, strain, car, ...); all by default")
    parser.add_argument("--quick", action="store_true", help="small sizes: see that all runs and agrees, time nothing")
    parser.add_argument("--long", action="store_true", help="grow to 1e8 samples (5 GB)")
    arguments = parser.parse_args()
    use_one_thread()
    text, agree = table(arguments.jobs, arguments.quick, arguments.long)
    publish("becalm beside others", __doc__, text, arguments.output)
    if not agree:
        raise SystemExit("A rival's results are not becalm's: see the last column.")


if __name__ == "__main__":
    main()
