"""Whether an output is ever farther from the truth than the range of the readings around it, whatever damages a record.

14 kinds of signal (8000 rows at 200 Hz, white noise of 5 % of their standard deviation; two are from real recordings)
are damaged by 21 insults, and cleaned in three ways: smoothed, causal, and with a lag of 20 rows. *file* is
`becalm.clean` without options; *live* is the stream that `becalm live` runs, and *C* is the float64 code of
`becalm export`; both use a recipe that was tuned on the undamaged record, and leave out insults of the sensor itself.
Cases in which the signal has more than twice the noise beyond half the rate of the readings are left out, because such
slow readings cannot show the signal.

Run: python benchmarks/safe.py [-o docs/safe.md] [--jobs N] [--quick] [--only SIGNAL,INSULT] [--path file|live|C]
[--estimate smoothed|causal|lag] [--all] [--keep FILE]; `--only ,INSULT` takes all signals. With `--fuzz N` random
records meet random insults in place of the table; `--fuzz-seed S` runs one of them again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
import traceback
import zlib
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import periodogram

import safe_bounds
from pages import page_parser, publish
from safe_bounds import Estimate, measures
from safe_fuzz import fuzz_page
from safe_insults import INSULTS
from safe_paths import Exported, Path_, by_file, by_stream
from safe_report import Result, page
from safe_signals import RATE_HZ, SIGNALS, Floats, Record, undamaged

ESTIMATES = {"file": ("smoothed", "causal", "lag"), "live": ("causal", "lag"), "C": ("causal",)}
OF_THE_SENSOR = ("each", "every", "resolution")
IN_C = ("walk", "order 2", "order 3", "tones", "stairs")
QUICK = (
    ("walk", "order 3", "band 30 Hz", "stairs", "real IMU"),
    ("gap 40", "gap 200", "blank ends", "spike 1e6", "1 % spikes", "wild ends", "held 40", "each 4 times", "shock"),
)
_SEED = 20261101


class Task(NamedTuple):
    """A signal, a path through becalm, a kind of estimate, and the insults to apply."""

    signal: str
    path: str
    estimate: str
    insults: tuple[str, ...]


def tasks(signals: Sequence[str], insults: Sequence[str], paths: Sequence[str]) -> list[Task]:
    """Return all tasks, the slowest path first."""
    found = []
    for path in paths:
        fitting = tuple(one for one in insults if path == "file" or not one.startswith(OF_THE_SENSOR))
        for estimate in ESTIMATES[path]:
            found += [Task(one, path, estimate, fitting) for one in signals if fitting and (path != "C" or one in IN_C)]
    return found


def generator(*names: str) -> np.random.Generator:
    """Return a random generator whose seed depends only on the names."""
    return np.random.default_rng([_SEED, *(zlib.crc32(name.encode()) for name in names)])


def run(task: Task) -> list[Result]:
    """Run a task; return its results, none if the signal's recording is absent."""
    record = undamaged(SIGNALS[task.signal], generator(task.signal))
    if record is None:
        return []
    began = time.perf_counter()
    with contextlib.ExitStack() as stack:
        try:
            path = _path(task, record, stack)
            sound = path(record.readings).signal - record.truth
        except Exception as error:
            return [_raised(task, "undamaged", error)]
        results = [result for insult in task.insults for result in _result(task, insult, record, (path, sound))]
    print(f"{' '.join(task[:3])}: {time.perf_counter() - began:.1f} s", file=sys.stderr)
    return results


def _path(task: Task, record: Record, stack: contextlib.ExitStack) -> Path_:
    """Return the function that cleans readings in a task."""
    if task.path == "C":
        return stack.enter_context(Exported(record.sound))
    if task.path == "live":
        return by_stream(record.sound, task.estimate)
    return lambda z: by_file(z, task.estimate)


def _result(task: Task, insult: str, record: Record, undamaged_: tuple[Path_, Floats]) -> list[Result]:
    """Damage a record, clean it, and return its measures; none if the readings are too slow for the signal."""
    path, sound = undamaged_
    damaged = INSULTS[insult](record, generator(task.signal, insult))
    if not is_seen(damaged):
        return []
    try:
        estimate: Estimate = path(damaged.readings)
        if damaged.every > 1:
            sound = _slower(record, damaged.every, task.estimate)
    except Exception as error:
        return [_raised(task, insult, error)]
    found = measures(estimate, sound, damaged, task.estimate)
    return [Result(task.signal, insult, task.estimate, task.path, found, "")]


def is_seen(record: Record) -> bool:
    """Return whether new readings are frequent enough: the signal beyond half their rate is at most twice the noise."""
    frequency, power = periodogram(record.truth, window="hann")
    beyond = frequency > 0.5 / record.every
    return float(power[beyond].sum() * frequency[1]) <= 4 * record.noise_std**2


def _slower(record: Record, every: int, estimate: str) -> Floats:
    """Return the error (N,) on the undamaged record of a slower sensor; NaN in rows without a reading of it."""
    error = np.full(len(record.truth), np.nan)
    out = by_file(np.ascontiguousarray(record.sound[::every]), estimate, RATE_HZ / every)
    error[::every] = out.signal - record.truth[::every]
    return error


def _raised(task: Task, insult: str, error: Exception) -> Result:
    """Return the result of a case that ended with an exception."""
    message = traceback.format_exception_only(error)[-1].strip()[:200]
    return Result(task.signal, insult, task.estimate, task.path, {"raised": 1.0}, message)


def run_all(todo: Sequence[Task], jobs: int) -> Iterator[list[Result]]:
    """Run tasks in `jobs` processes."""
    if jobs == 1:
        yield from map(run, todo)
        return
    with get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap(run, todo)


def kept(todo: Sequence[Task], jobs: int, keep: Path | None) -> list[Result]:
    """Run tasks, and return their results in the order of the tasks.

    With a file `keep`, results are appended to it, and tasks whose results it contains are not run again.
    """
    place = {task[:3]: number for number, task in enumerate(todo)}

    def of_task(one: Result) -> int:
        return place.get((one.signal, one.path, one.estimate), len(todo))

    if keep is None:
        return sorted((one for results in run_all(todo, jobs) for one in results), key=of_task)
    lines = keep.read_text(encoding="utf-8").splitlines() if keep.exists() else []
    found = [Result(*json.loads(line)) for line in lines]
    done = {(one.signal, one.path, one.estimate) for one in found}
    with keep.open("a", encoding="utf-8") as file:
        for results in run_all([task for task in todo if task[:3] not in done], jobs):
            file.writelines(f"{json.dumps(one)}\n" for one in results)
            file.flush()
            found += results
    return sorted(found, key=of_task)


def chosen(arguments: argparse.Namespace) -> list[Task]:
    """Return the tasks for the arguments of the command line."""
    signals, insults = QUICK if arguments.quick else (tuple(SIGNALS), tuple(INSULTS))
    signal, _, insult = arguments.only.partition(",")
    signals = tuple(one for one in SIGNALS if one == signal) if signal else signals
    insults = tuple(one for one in INSULTS if one.startswith(insult)) if insult else insults
    if not signals or not insults:
        raise SystemExit(f"--only {arguments.only!r}: signals are {', '.join(SIGNALS)}; insults {', '.join(INSULTS)}.")
    todo = tasks(signals, insults, [arguments.path] if arguments.path else list(ESTIMATES))
    if arguments.estimate:
        return [one for one in todo if one.estimate == arguments.estimate]
    return [one for one in todo if not (arguments.quick and one.estimate == "lag")]


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--quick", action="store_true", help="five signals, nine insults, no lag")
    parser.add_argument("--only", default="", help="SIGNAL,INSULT; either may be empty, and insults may be cut short")
    parser.add_argument("--path", choices=list(ESTIMATES), help="only this way through becalm")
    parser.add_argument("--estimate", choices=ESTIMATES["file"], help="only this one")
    parser.add_argument("--all", action="store_true", help="list every violation, not only the worst")
    parser.add_argument("--keep", type=Path, help="a file for results; what is in it is not run again")
    parser.add_argument("--fuzz", type=int, default=0, help="so many random records instead")
    parser.add_argument("--fuzz-from", type=int, default=0, help="the first seed of them")
    parser.add_argument("--fuzz-seed", type=int, help="one random record, and what befell it")
    arguments = parser.parse_args()
    about = f"{__doc__}\n{safe_bounds.__doc__}"
    if arguments.fuzz or arguments.fuzz_seed is not None:
        first = arguments.fuzz_from if arguments.fuzz_seed is None else arguments.fuzz_seed
        text = fuzz_page(range(first, first + max(arguments.fuzz, 1)), arguments.jobs)
        publish("Safe on any record: random records", about, text, arguments.output)
        return
    publish(
        "Safe on any record",
        about,
        page(kept(chosen(arguments), arguments.jobs, arguments.keep), arguments.all),
        arguments.output,
    )


if __name__ == "__main__":
    main()
