"""What a report costs in addition to the filtering, on a large Parquet file, and the size of the page.

The file is that of `large_files.py`: a time column and six channels of random walks in white noise. Wall-clock times of
whole processes, which take turns: `becalm clean` with a recipe, without and with a report. The tables show medians of
the difference within each turn, the peak memory of any run, and the size of the page.

Run: python benchmarks/reporting.py [--rows 10000000] [--repeats 3] [-o docs/reporting.md]
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median

from large_files import MODES, make, run, tune
from pages import page_parser, publish

MOST_SECONDS, MOST_BYTES = 10.0, 2_000_000
"""Required of a page on ten million rows of six channels."""


def table(rows: int, repeats: int) -> str:
    """Measure, and return the table."""
    lines = [
        f"{rows:,} rows, {repeats} turns. Asked: under {MOST_SECONDS:g} s, and under {MOST_BYTES:,} bytes.",
        "",
        "| mode | without, s | with a report, s | the report, s | most MB without | most MB with | page, bytes |",
        "|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as name:
        source = Path(name) / "in.parquet"
        make(source, rows)
        for mode in MODES:
            words, page = tune(source, mode), source.with_name(f"{mode}.html")
            run([*words, "--report", str(page)])  # a first run fills the caches
            turns = [(run(words), run([*words, "--report", str(page)])) for _ in range(repeats)]
            cost = median(drawn.seconds - plain.seconds for plain, drawn in turns)
            seconds = [median(turn[place].seconds for turn in turns) for place in (0, 1)]
            most = [max(turn[place].megabytes for turn in turns) for place in (0, 1)]
            cells = (f"{seconds[0]:.2f}", f"{seconds[1]:.2f}", f"{cost:.2f}", f"{most[0]:.0f}", f"{most[1]:.0f}")
            lines.append(f"| {mode} | {' | '.join(cells)} | {page.stat().st_size:,} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Print the table; with -o, write it as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000, help="how long")
    parser.add_argument("--repeats", type=int, default=3, help="turns")
    arguments = parser.parse_args()
    publish("What a report costs", __doc__, table(arguments.rows, arguments.repeats), arguments.output)


if __name__ == "__main__":
    main()
