"""What an exported filter costs on this machine: nanoseconds a row, bytes of code, of state and of tables.

Each filter is exported with default options, compiled by gcc and by clang, and run over blocks of 4096 noisy readings
that stay in the cache; the shortest of several runs counts. *Code* is the size of all functions (init, reset, step,
step_block, gap) at -Os, without tables; *state* and *tables* are the sizes in the header, which the compiler checks.
The last line compares with `memcpy` of a row of 4 bytes, which no filter can beat.

Run: python benchmarks/export_speed.py [-o docs/export-speed.md]
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe, LimitsRecipe, ModeRecipe, SwitchingRecipe, ToneRecipe
from becalm.errors import BecalmError
from becalm.export.bundle import Bundle, ExportOptions, bundle_of
from becalm.export.number_type import Precision
from becalm.export.proof.compiling import build, compilers, run
from becalm.export.proof.verifying import write_bundle
from pages import page_parser, publish

_RATE_HZ = 100.0
_ROWS, _RUNS = 20_000_000, 7
_SLOW_ROWS = 1_000_000
_TONE = ToneRecipe(frequency_hz=5.0, bandwidth_hz=0.05, process_noise_density=0.1)
_PRECISIONS: tuple[Precision, ...] = ("float32", "float64", "q31")
_COPY = """#include <stdio.h>
#include <string.h>
#include <time.h>
static float a[4096], b[4096];
int main(void) {
    const clock_t begun = clock();
    for (int k = 0; k < 200000; k++) { memcpy(b, a, sizeof a); __asm__ volatile("" : : "r"(b) : "memory"); }
    printf("%.3f ns\\n", 1e9 * (double)(clock() - begun) / CLOCKS_PER_SEC / 200000.0 / 4096.0);
    return 0;
}
"""


class Cost(NamedTuple):
    """The cost of one filter."""

    ns: dict[str, float]  # nanoseconds per row, by compiler
    code_bytes: int
    state_bytes: int
    table_bytes: int
    says: str


def motion(order: int, cutoff: float, **more: Any) -> ChannelRecipe:
    """Return a kinematic model with a cut-off in radians per step, and a noise standard deviation of 1."""
    density = cutoff ** (2 * order) * _RATE_HZ ** (2 * order - 1)
    return ChannelRecipe(
        name="ax", unit="m/s^2", model="motion", order=order, process_noise_density=density, noise_std=1.0, **more
    )


def channels() -> dict[str, ChannelRecipe]:
    """Return the filters to measure, by title."""
    modes = tuple(
        ModeRecipe(name=name, order=1, process_noise_density=q, noise_std=1.0, lasts_s=lasts)
        for name, q, lasts in (("still", 1e-4, 10.0), ("moving", 100.0, 1.0))
    )
    bank = SwitchingRecipe(kind="resting", mode=modes)
    return {
        "order 1, settled": motion(1, 0.2),
        "order 2, settled": motion(2, 0.05),
        "order 3, settled": motion(3, 0.05),
        "order 2, settled, with limits": motion(2, 0.05, limits=LimitsRecipe(low=-99.0, high=99.0, stuck_readings=9)),
        "order 2 and a tone, settled": motion(2, 0.05, tone=(_TONE,)),
        "order 2, full covariance and gate": motion(2, 0.05, gate=GateRecipe()),
        "two modes of order 1": motion(1, 0.05, switching=bank),
    }


def cost(channel: ChannelRecipe, precision: Precision) -> Cost:
    """Measure one filter."""
    recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=_RATE_HZ), channel=(channel,))
    spans = {channel.name: (-100.0, 100.0)} if precision == "q31" else {}
    bundle = bundle_of(recipe, "cost", ExportOptions(precision=precision, spans=spans))
    (one,) = bundle.channels
    with tempfile.TemporaryDirectory() as place:
        folder = write_bundle(bundle, Path(place))
        ns = {name: _nanoseconds(bundle, folder, name) for name in compilers()}
        code = _code_bytes(bundle, folder)
    return Cost(ns, code, one.written.state_bytes, one.written.table_bytes, str(one.written.cost))


def _nanoseconds(bundle: Bundle, folder: Path, compiler: str) -> float:
    made = build(folder, bundle.stem, compiler, ("-O2",))
    prefix = bundle.channels[0].prefix
    slow = _took(run(made, prefix, "time", str(_SLOW_ROWS)).stdout)
    rows = _ROWS if slow < 20 else _SLOW_ROWS
    return min(_took(run(made, prefix, "time", str(rows)).stdout) for _ in range(_RUNS))


def _took(output: str) -> float:
    return float(output.split()[-2])


def _code_bytes(bundle: Bundle, folder: Path) -> int:
    """Return the size of all functions at -Os in bytes, without tables."""
    made = folder / "small.o"
    subprocess.run(["cc", "-std=c99", "-Os", "-c", folder / f"{bundle.stem}.c", "-o", made], check=True)
    listed = subprocess.run(["nm", "-S", made], capture_output=True, text=True, check=True).stdout
    return sum(int(size, 16) for size in re.findall(r"^\w+ (\w+) [tT] ", listed, re.MULTILINE))


def copied_ns() -> float:
    """Return how long copying a row takes, in nanoseconds."""
    with tempfile.TemporaryDirectory() as place:
        source, program = Path(place) / "copy.c", Path(place) / "copy"
        source.write_text(_COPY, encoding="utf-8")
        subprocess.run(["cc", "-O2", source, "-o", program], check=True)
        return min(_took(subprocess.run([program], capture_output=True, text=True, check=True).stdout) for _ in "12345")


def lines() -> Iterator[str]:
    """Return the page's lines."""
    names = compilers()
    took = " | ".join(f"ns a row, {name}" for name in names)
    yield f"| filter | numbers | {took} | code | state | tables | a row |"
    yield f"|---|---|{'---|' * len(names)}---|---|---|---|"
    for title, channel in channels().items():
        for precision in _PRECISIONS:
            try:
                found = cost(channel, precision)
            except BecalmError:
                continue  # q31 cannot represent this filter
            took = " | ".join(f"{found.ns[name]:.2f}" for name in names)
            yield (
                f"| {title} | {precision} | {took} | {found.code_bytes} B | {found.state_bytes} B"
                f" | {found.table_bytes} B | {found.says} |"
            )
    yield ""
    yield f"`memcpy`: {copied_ns():.2f} ns a row of 4 bytes."


def main() -> None:
    """Print the table, and write it to a page."""
    arguments = page_parser(__doc__).parse_args()
    publish("What an exported filter costs", __doc__, "\n".join(lines()) + "\n", arguments.output)


if __name__ == "__main__":
    main()
