"""Write the certificate of an export: the builds that were run, and the results of all checks and comparisons."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from becalm.export.bundle import Bundle
from becalm.export.proof.compiling import version_of
from becalm.export.proof.verifying import RecordComparison, Verification


def certificate(bundle: Bundle, verified: Verification) -> str:
    """Return the certificate as a Markdown page."""
    names = list(dict.fromkeys(one.build.compiler for one in verified.runs))
    vectors = sum(len(one.vectors) for one in bundle.channels)
    lines = [f"# Certificate of {bundle.stem}", ""]
    lines += [f"Results of the checks that ran when these files were made, with {vectors} golden vectors.", ""]
    lines += [f"- {name}: {version_of(name)}" for name in names]
    lines += ["", "| compiler | flags | vectors and checks |", "|---|---|---|"]
    lines += [
        f"| {one.build.compiler} | `{' '.join(one.build.flags)}` | {'all passed' if one.passed else 'FAILED'} |"
        for one in verified.runs
    ]
    lines += ["", "| channel | record | rows | reference | greatest difference | signal over difference |"]
    lines += ["|---|---|---|---|---|---|"]
    lines += [
        f"| {one.channel} | {one.record} | {one.rows} | {one.beside} | {_greatest(one)} | {_decibels(one)} |"
        for one in verified.compared
    ]
    return "\n".join([*lines, "", *_files(bundle)]) + "\n"


def _greatest(one: RecordComparison) -> str:
    return f"{one.error:.2g} of the greatest signal{f', in row {one.error_row}' if one.error > 0 else ''}"


def _decibels(one: RecordComparison) -> str:
    ratio = "no difference" if np.isinf(one.snr_db) else f"{one.snr_db:.1f} dB"
    return ratio if one.kept else f"{ratio}, which is less than promised"


def _files(bundle: Bundle) -> list[str]:
    return ["| file | SHA-256 |", "|---|---|"] + [
        f"| {path} | `{sha256(text.encode()).hexdigest()}` |" for path, text in sorted(bundle.files.items())
    ]
