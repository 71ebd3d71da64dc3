"""Instructions per sample of settled exported filters, counted on emulated Cortex-Ms.

Instructions are counted, not cycles: with -icount shift=0, QEMU advances the board's clock by one nanosecond for each
instruction. The board's timer is read before and after blocks of half the golden readings and of all of them; the
difference is the count of the second half, including the check of each reading and the loop. Two loops of known length
are counted first, and a wrong count ends the run. On a Cortex-M4F most instructions take one cycle; loads, branches
and multiply-adds take more. Channels: models of order 1 (level), order 2 (slope), order 2 with saturation limits and a
check for stuck readings (railed), order 3 (bend), and order 2 with one tone. Compiled by arm-none-eabi-gcc -O2.

Run: python benchmarks/export_cortex.py [-o docs/export-cortex.md]   (needs arm-none-eabi-gcc, newlib, qemu-system-arm)
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, get_args

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe, ToneRecipe
from becalm.export.bundle import ExportOptions, bundle_of
from becalm.export.number_type import Precision
from becalm.export.proof.verifying import write_bundle
from pages import page_parser, publish

RATE_HZ = 100.0
PROGRAMS = ("make", "arm-none-eabi-gcc", "qemu-system-arm")
CORES = {"m4": "Cortex-M4F", "m3": "Cortex-M3", "m0": "Cortex-M0"}
SPAN = (-300.0, 300.0)
TONE = ToneRecipe(frequency_hz=5.0, bandwidth_hz=0.01, process_noise_density=0.1)
LIMITS = LimitsRecipe(low=SPAN[0], high=SPAN[1], stuck_readings=7)


class Count(NamedTuple):
    """The instructions per sample of one channel on one core."""

    precision: str
    channel: str
    core: str
    instructions: float


def motion(name: str, order: int, cutoff: float, **more: object) -> ChannelRecipe:
    """Return a kinematic model with a cut-off in radians per step, and a noise standard deviation of 1."""
    density = cutoff ** (2 * order) * RATE_HZ ** (2 * order - 1)
    fields = {"name": name, "unit": "m/s^2", "model": "motion", "order": order, "noise_std": 1.0, **more}
    return ChannelRecipe.model_validate({**fields, "process_noise_density": density})


CHANNELS = (
    motion("level", 1, 0.05),
    motion("slope", 2, 0.05),
    motion("railed", 2, 0.05, limits=LIMITS),
    motion("bend", 3, 0.05),
    motion("tone", 2, 0.05, tone=(TONE,)),
)


def counts(precision: Precision) -> Iterator[Count]:
    """Export the channels, and count on every core.

    Raises
    ------
    subprocess.CalledProcessError
        If a channel does not compile, a golden vector fails, or the known loops are counted wrongly.
    """
    recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=RATE_HZ), channel=CHANNELS)
    spans = {one.name: SPAN for one in CHANNELS}
    bundle = bundle_of(recipe, "bench", ExportOptions(precision, spans=spans))
    with tempfile.TemporaryDirectory(prefix="becalm-cortex-") as place:
        folder = write_bundle(bundle, Path(place))
        for core, name in CORES.items():
            make(folder, f"cortex-{core}")
            output = make(folder, f"cortex-{core}-count")
            for channel, many in re.findall(r"^bench_(\w+): ([\d.]+) instructions a sample", output, re.M):
                yield Count(precision, channel, name, float(many))


def make(folder: Path, target: str) -> str:
    """Run make, and return its output; if make fails, print the output."""
    ran = subprocess.run(["make", "-s", "-C", str(folder), target], capture_output=True, text=True, check=False)
    if ran.returncode != 0:
        print(ran.stdout, ran.stderr, file=sys.stderr)
    ran.check_returncode()
    return ran.stdout


def table(found: list[Count]) -> str:
    """Return a table in Markdown: a row for each channel, a column for each core and precision."""
    columns = [(core, precision) for core in CORES.values() for precision in get_args(Precision)]
    by = {(one.channel, one.core, one.precision): one.instructions for one in found}
    rows = [
        "| channel | " + " | ".join(f"{core} {precision}" for core, precision in columns) + " |",
        "|---|" + "---:|" * len(columns),
    ]
    for channel in CHANNELS:
        cells = [f"{by[channel.name, core, precision]:.1f}" for core, precision in columns]
        rows.append(f"| {channel.name} | " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    if missing := [program for program in PROGRAMS if shutil.which(program) is None]:
        print(f"{missing[0]} is not installed: nothing was counted, and no page written.", file=sys.stderr)
        return
    found = [one for precision in get_args(Precision) for one in counts(precision)]
    publish("Exported filters on Cortex-Ms: instructions a sample", __doc__, table(found), output)


if __name__ == "__main__":
    main()
