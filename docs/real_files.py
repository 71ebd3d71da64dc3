"""Inspect and clean every real CSV file without options, or with the option that a refusal asks for.

Run: python docs/real_files.py [-o docs/real-files.md]   (the recordings are in ../shared/data)
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

DATA = Path(__file__).parents[2] / "shared" / "data"
FOLDERS = ("comma2k19", "munich_bridge", "fusion", "gaitmap")
NEEDED = {"imu_sample.csv": ["--rate", "204.8"], "mocap_sample.csv": ["--rate", "100"]}


def files() -> list[Path]:
    """List the recordings."""
    return sorted(path for folder in FOLDERS for path in (DATA / folder).glob("*.csv*"))


def becalm(*words: object) -> subprocess.CompletedProcess[str]:
    """Run the command line."""
    command = [sys.executable, "-m", "becalm", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=DATA)


def section(path: Path, folder: Path) -> str:
    """Return the section of the page on one file."""
    name = path.relative_to(DATA)
    lines = [f"## {name}", ""]
    options: list[str] = []
    plain = becalm("clean", name, "-o", folder / "out.csv", "--json")
    if plain.returncode == 3:
        options = NEEDED.get(path.name, [])
        lines += [f"`becalm clean {name}` (exit code 3):", "", f"> {plain.stderr.strip()}", ""]
        plain = becalm("clean", name, "-o", folder / "out.csv", "--json", *options)
    summary = json.loads(plain.stdout)
    seen = json.loads(becalm("inspect", name, "--json", *options).stdout)
    facts = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in seen.items() if _is_fact(key, value))
    lines += [f"`{' '.join(['becalm clean', str(name), *options])}` (exit code {plain.returncode}): {facts}.", ""]
    lines += [
        "| channel | unit | order, tones | noise | q/r | bandwidth (Hz) | predictable | costs | uneven | verdict |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [_row(channel) for channel in summary["channels"]]
    return "\n".join(lines) + "\n"


def _tones(channel: dict[str, object]) -> str:
    """Return the frequencies of the tones, to follow the order of the kinematic model."""
    tones = channel["tones_hz"]
    return "".join(f", {frequency:.4g} Hz" for frequency in tones) if isinstance(tones, list) else ""


def _is_fact(key: str, value: object) -> bool:
    return key not in ("file", "columns") and value not in (None, "", [], {})


def _row(channel: dict[str, object]) -> str:
    if channel["order"] is None:
        return f"| {channel['name']} | {channel['unit']} | {channel['model']} | | | | | | | {channel['verdict']} |"
    bandwidth = "" if channel["bandwidth_hz"] is None else f"{channel['bandwidth_hz']:.3g}"
    return (
        f"| {channel['name']} | {channel['unit']} | {channel['order']}{_tones(channel)} | {channel['noise_std']:.3g} |"
        f" {channel['q_over_r']:.2g} | {bandwidth} | {channel['predictable_share']:.0%} |"
        f" {channel['excess_error']:.0%} | {channel['uneven_share']:.0%} | {channel['verdict']} |"
    )


def main() -> None:
    """Print the page; with -o, write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("-o", "--output", type=Path, help="page to write")
    output: Path | None = parser.parse_args().output
    with tempfile.TemporaryDirectory() as folder:
        sections = [section(path, Path(folder)) for path in files()]
    text = "# Real files\n\n" + _PREFACE + "\n" + "\n".join(sections)
    print(text)
    if output:
        output.write_text(text, encoding="utf-8")


_PREFACE = """Every CSV of the real recordings, cleaned with no option, or refused and then cleaned with the
option that the refusal names. Written by `docs/real_files.py`. *predictable* is the share of the innovation
power that a linear predictor can predict, *costs* is the resulting excess of the rms error over the least possible one,
and *uneven* is the share of the record in which sigma is wrong by more than a factor of two. If *uneven*, or both
*predictable* and *costs*, exceed 10 %, the model does not fit, and the exit code is 4.
"""


if __name__ == "__main__":
    main()
