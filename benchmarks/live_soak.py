"""A soak at full speed: 1e8 samples through a stream's filters, held against the file's way.

Readings of six channels come in blocks of 65 536 rows, as fast as they go, to the filters of
`live_runs.recipe_of` (motion of order 2, gate, limits), and the same readings go through `clean --causal`'s way in
chunks. The signals must agree to 1e-12, every state be finite, and memory stay flat: the process' memory is looked at
after each block, and told for the first quarter and for what follows.

Run: python benchmarks/live_soak.py [--samples 1e8] [-o docs/live-soak.md]
"""

from __future__ import annotations

import time

import numpy as np

from becalm.cleaning.cleaner import Cleaner
from becalm.live.block import Block
from becalm.live.stream import Stream
from becalm.live.watching.memory import resident_bytes
from live_runs import names_of, readings, recipe_of
from pages import page_parser, publish

CHANNELS, RATE_HZ, ROWS = 6, 10_000.0, 1 << 16


def main() -> None:
    """Run the soak."""
    parser = page_parser(__doc__)
    parser.add_argument("--samples", type=float, default=1e8, help="rows times channels")
    asked = parser.parse_args()
    recipe, blocks = recipe_of(CHANNELS, RATE_HZ), max(4, round(asked.samples / CHANNELS / ROWS))
    stream, some = Stream(recipe, 1 / RATE_HZ), readings(ROWS * 4, CHANNELS, RATE_HZ)
    names, units = tuple(names_of(CHANNELS)), ("m/s^2",) * CHANNELS
    memory, took_s, apart, finite = [], 0.0, 0.0, True
    with Cleaner(recipe, 1 / RATE_HZ) as cleaner:
        for number in range(blocks):
            values = some[number % 4 * ROWS :][:ROWS] + 1e-3 * np.sin(number)
            elapsed = np.ones(ROWS)
            elapsed[0] = float(number > 0)
            stamps = (number * ROWS + np.arange(ROWS)) / RATE_HZ
            begun = time.perf_counter()
            told = stream.take(Block(names, units, stamps, values, "", elapsed))
            took_s += time.perf_counter() - begun
            (filed,) = cleaner.push([np.ascontiguousarray(column) for column in values.T], elapsed)
            clean = np.column_stack([channel.signal for channel in filed])
            known = np.isfinite(clean)
            finite = finite and bool(np.isfinite(told.signal[known]).all())
            scale = np.abs(clean[known]).max()
            apart = max(apart, float(np.abs(told.signal[known] - clean[known]).max() / scale))
            memory.append((resident_bytes() or 0) / 1e6)
    samples, later = blocks * ROWS * CHANNELS, memory[len(memory) // 4 :]
    lines = ["| |", "|---|--:|", f"samples | {samples:.3g}", f"seconds in the stream | {took_s:.1f}"]
    lines += [f"samples a second | {samples / took_s:.3g}"]
    lines += [f"memory after the first quarter, MB | {min(later):.0f} to {max(later):.0f}"]
    lines += [f"farthest from the file's way, of the greatest signal | {apart:.2g}"]
    lines += [
        f"snapshot, bytes | {len(stream.checkpoint('', '').snapshot)}",
        f"all finite | {'yes' if finite else 'NO'}",
    ]
    publish("A soak of a live stream", __doc__, "\n".join(lines) + "\n", asked.output)


if __name__ == "__main__":
    main()
