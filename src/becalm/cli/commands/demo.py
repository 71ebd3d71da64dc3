"""Run the demonstration: clean a simulated drive without options, and compare with the best hand-tuned filter."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from becalm.cleaning.pipeline import Cleaned
    from becalm.studies.drive import Drive


def run(folder: Path) -> None:
    """Write a simulated drive and its clean signal into a folder, and print the errors."""
    from becalm.cleaning.pipeline import clean
    from becalm.cli.opened_file import recipe_path_of
    from becalm.files.atomic_file import make_folder, write_text
    from becalm.files.inputs.opening import read
    from becalm.files.outputs.writing import write
    from becalm.report.page import Facts, page_of
    from becalm.report.running import pictures_of
    from becalm.studies.drive import simulate

    make_folder(folder)
    drive = simulate()
    raw, calm, live = folder / "drive.csv", folder / "drive_clean.csv", folder / "drive_causal.csv"
    write(folder / "drive_truth.csv", drive.truth)
    write(raw, drive.measured)
    recording = read(raw)
    smoothed, causal = clean(recording), clean(recording, causal=True)
    for path, cleaned in ((calm, smoothed), (live, causal)):
        write(path, cleaned.signal, cleaned.sigma)
        write_text(recipe_path_of(path), cleaned.recipe.to_toml())
    page = folder / "drive_clean.html"
    facts = Facts(raw.name)
    write_text(page, page_of(facts, smoothed.recipe, pictures_of(recording, smoothed.recipe)))
    out = Console(highlight=False, soft_wrap=True, markup=False)
    out.print("A simulated test drive, 60 s at 500 Hz, cleaned with no options. Best classic: the best causal")
    out.print("Butterworth (order 1, 2, 4) or moving average, its cut-off chosen knowing the truth.\n")
    out.print(_figures(drive, smoothed, causal))
    out.print("\nThe files:")
    out.print("\n".join(f"  {path}" for path in (raw, calm, live, page)))
    out.print(f"Try it on your own file: becalm clean FILE -o {folder / 'mine.csv'}")


def _figures(drive: Drive, smoothed: Cleaned, causal: Cleaned) -> Table:
    from becalm.classic.matching import best_of
    from becalm.classic.register import USUAL
    from becalm.metrics.truth import coverage, rms_error

    table = Table(box=None, pad_edge=False)
    headings = ("rms error of", "raw", "best classic", "causal", "smoothed", "within 1 sigma")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == headings[0] else "right", no_wrap=True)
    for i, name in enumerate(drive.truth.names):
        truth, measured = drive.truth.samples[:, i], drive.measured.samples[:, i]
        signal, sigma = smoothed.signal.samples[:, i], smoothed.sigma.samples[:, i]
        table.add_row(
            name,
            f"{rms_error(measured, truth):.4f}",
            f"{best_of(USUAL[True], measured, truth).error:.4f}",
            f"{rms_error(causal.signal.samples[:, i], truth):.4f}",
            f"{rms_error(signal, truth):.4f}",
            f"{coverage(signal, sigma, truth):.0%}",
        )
    return table
