"""Exported C, becalm's stream and a causal clean give bitwise the same signal, with every compiler.

*Recordings*: every channel of every recording is tuned as a causal filter (on its first 20 000 rows), exported with its
full covariance as float64, compiled by `cc -O2`, and run over the record, as are becalm's own stream in blocks of 50
rows and a causal `clean`; signals are compared bitwise in the rows in which the stream has a signal. *Compilers*: one
export of many filters (orders 1 to 5 with a gate, a tone, coloured noise, several modes) is compiled in each way that
this machine offers, and run over 20 000 readings with spikes, steps and holes. zig is the one in the package ziglang;
its programs for aarch64 run under qemu-aarch64.

Run: python benchmarks/same_bits.py [-o docs/same-bits.md] [NAME ...]; needs `pip install 'becalm[formats]'`.
The recordings lie in ../shared/data; with names, only files whose path holds one of them are taken.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np

import becalm
from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import ColouredNoiseRecipe, GateRecipe, ToneRecipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Floats
from becalm.errors import BecalmError
from becalm.export.bundle import Bundle, ExportOptions, bundle_of
from becalm.export.proof.compiling import STRICT, build
from becalm.export.proof.verifying import run_in_c, write_bundle
from export_records import recordings, tuned
from pages import page_parser, publish

_ROWS, _BLOCK = 20_000, 50
_RATE_HZ = 100.0
_OPTIMISED = ("-O1", "-O2", "-O3")
_AARCH64 = ("-target", "aarch64-linux-musl", "-static")


class Way(NamedTuple):
    """A command to compile a program, and a command that runs it."""

    name: str
    compiler: tuple[str, ...]
    runs: tuple[str, ...] = ()


def ways() -> list[Way]:
    """Return the compilers on this machine."""
    found = [Way(f"{name} {how}", (name, how)) for name in ("gcc", "clang") if shutil.which(name) for how in _OPTIMISED]
    if find_spec("ziglang"):
        zig = (sys.executable, "-m", "ziglang", "cc")
        found.append(Way("zig cc -O2", (*zig, "-mcpu=baseline", "-O2")))
        if shutil.which("qemu-aarch64"):
            found.append(Way("zig cc -O2, aarch64", (*zig, *_AARCH64, "-O2"), ("qemu-aarch64",)))
    return found


def many_filters() -> Recipe:
    """Return a recipe of filters of all kinds."""
    tone = ToneRecipe(frequency_hz=17.0, bandwidth_hz=0.2, process_noise_density=1.0)
    coloured = ColouredNoiseRecipe(rate_hz=_RATE_HZ, coefficients=(0.6, 0.1), std=2.0)
    cutoffs = (0.2, 0.05, 0.05, 0.1, 0.3)
    gated = [_channel(f"order {k}", k, cutoff, gate=GateRecipe()) for k, cutoff in enumerate(cutoffs, start=1)]
    others = [_channel("tone", 2, 0.05, tone=(tone,)), _channel("coloured", 2, 0.05, coloured_noise=coloured)]
    stairs = np.repeat(4 * np.random.default_rng(1).normal(size=10), 600)
    readings = stairs + np.random.default_rng(2).normal(size=len(stairs))
    (switching,) = becalm.tune(becalm.Recording(readings, names=["modes"], rate_hz=_RATE_HZ), causal=True).channel
    assert switching.switching is not None, "stairs are modes"
    return Recipe(mode="causal", tuned_on=Origin(rate_hz=_RATE_HZ), channel=(*gated, *others, switching))


def _channel(name: str, order: int, cutoff: float, **more: object) -> ChannelRecipe:
    density = cutoff ** (2 * order) * _RATE_HZ ** (2 * order - 1)
    own = {"name": name, "model": "motion", "order": order, "process_noise_density": density, "noise_std": 1.0, **more}
    return ChannelRecipe.model_validate(own)


def rough() -> Floats:
    """Return readings with spikes, steps and holes."""
    rng = np.random.default_rng(3)
    z = 12 * np.sin(np.arange(_ROWS) / 40) + rng.normal(size=_ROWS)
    for row in rng.integers(100, _ROWS - 100, 30).tolist():
        z[row:] += rng.normal() * 20
        z[row + 50 : row + 50 + int(rng.integers(2, 80))] = np.nan
    z[rng.random(_ROWS) < 0.01] += 200.0
    z[rng.random(_ROWS) < 0.02] = np.nan
    return z


def by_compilers() -> str:
    """Return the table of compilers."""
    recipe, readings = many_filters(), rough()
    bundle = bundle_of(recipe, "many", ExportOptions(precision="float64", gain="full"))
    own = hashlib.sha256()
    for channel in recipe.channel:
        own.update(_known_bytes(_stream(channel, _RATE_HZ, readings)))
    lines = ["| compiled by | SHA-256 of all signals |", "|---|---|", f"| becalm's stream | `{own.hexdigest()[:16]}` |"]
    for way in ways():
        print(way.name, file=sys.stderr)
        lines.append(f"| {way.name} | `{_by(way, bundle, recipe, readings)[:16]}` |")
    return "\n".join(lines) + "\n"


def _by(way: Way, bundle: Bundle, recipe: Recipe, readings: Floats) -> str:
    """Compile and run all filters; return the hash of their signals, in the rows in which becalm's stream has one."""
    found = hashlib.sha256()
    with tempfile.TemporaryDirectory() as place:
        folder = write_bundle(bundle, Path(place))
        texts = [path for path in bundle.files if path.endswith(".c") and path.count("/") == path.startswith("native/")]
        words = [*way.compiler, *STRICT[:1], STRICT[-1], *texts, "-o", "check", "-lm"]
        subprocess.run(words, cwd=folder, check=True, capture_output=True)
        (folder / "in").write_bytes(readings.tobytes())
        for one, channel in zip(bundle.channels, recipe.channel, strict=True):
            subprocess.run([*way.runs, "./check", one.prefix, "in", "out", "status"], cwd=folder, check=True)
            signal = np.frombuffer((folder / "out").read_bytes(), np.float64)
            found.update(_known_bytes(np.where(np.isnan(_stream(channel, _RATE_HZ, readings)), np.nan, signal)))
    return found.hexdigest()


def _known_bytes(signal: Floats) -> bytes:
    return signal[~np.isnan(signal)].tobytes()


def _stream(channel: ChannelRecipe, rate_hz: float, readings: Floats) -> Floats:
    """Return the signal of becalm's stream for readings in blocks."""
    recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=rate_hz), channel=(channel,))
    stream = StreamCleaner(recipe, 1 / rate_hz)
    parts = [
        stream.push(np.ascontiguousarray(readings[k : k + _BLOCK, np.newaxis]), np.ones(len(readings[k : k + _BLOCK])))
        for k in range(0, len(readings), _BLOCK)
    ]
    return np.concatenate([part.signal[:, 0] for part in parts])


class Compared(NamedTuple):
    """The comparison of one recording."""

    record: str
    channels: int
    rows: int
    stream_differences: int  # number of samples of C that differ from the stream's
    clean_differences: int  # number of samples of the stream that differ from those of `clean`
    refused: int  # number of channels that are not exported


def _compared(title: str, recording: becalm.Recording) -> Compared:
    rate_hz, counted, from_stream, from_clean, refused = recording.timebase.rate_hz, 0, 0, 0, 0
    for channel in tuned(recording):
        if channel.motion is None:
            continue
        readings = np.ascontiguousarray(recording.samples[:, recording.names.index(channel.name)])
        recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=rate_hz), channel=(channel,))
        try:
            bundle = bundle_of(recipe, "record", ExportOptions(precision="float64", gain="full"))
        except BecalmError:
            refused += 1
            continue
        with tempfile.TemporaryDirectory() as place:
            program = build(write_bundle(bundle, Path(place)), bundle.stem, "cc", ("-O2",))
            (one,) = bundle.channels
            signal, _ = run_in_c(program, one, one.kind.raw(readings, one.written))
        even = becalm.Recording(readings, names=[channel.name], units=[channel.unit], rate_hz=rate_hz)
        cleaned = becalm.clean(even, recipe).signal.samples[:, 0]
        streaming = _stream(channel, rate_hz, readings)
        counted += 1
        from_stream += int(np.count_nonzero((signal != streaming) & ~np.isnan(streaming)))
        from_clean += int(np.count_nonzero((cleaned != streaming) & ~(np.isnan(streaming) & np.isnan(cleaned))))
    return Compared(title, counted, len(recording), from_stream, from_clean, refused)


def page(names: Sequence[str]) -> str:
    """Return both tables."""
    lines = ["## Compilers", "", by_compilers(), "## Recordings", ""]
    lines += [f"Of the recordings those whose path holds one of: {', '.join(names)}.", ""] if names else []
    lines += ["| recording | rows | channels | C beside the stream: differ | stream beside `clean`: differ | refused |"]
    lines += ["|---|---|---|---|---|---|"]
    every = [_compared(*titled) for titled in recordings(names)]
    for one in every:
        lines.append(f"| {' | '.join(map(str, (one.record, one.rows, one.channels, *one[3:])))} |")
    total = [sum(column) for column in zip(*(one[1:] for one in every), strict=True)] or [0] * 5
    lines.append(f"| all | {total[1]} | {total[0]} | {' | '.join(map(str, total[2:]))} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args()
    publish("The same bits", __doc__, page(arguments.names), arguments.output)


if __name__ == "__main__":
    main()
