"""Handle files with several time bases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from becalm.cli.messages import print_columns, print_notes, stderr
from becalm.errors import UsageError
from becalm.files.outputs.tables import with_time
from becalm.files.registry import MF4, format_to_write, stores_several_times

if TYPE_CHECKING:
    import pyarrow as pa

    from becalm.files.inputs.opening import OpenSource
    from becalm.files.inputs.time_bases import OpenFile

_MOST_NAMED = 12  # largest number of groups in a message


def refuse_several_time_bases(output: Path, groups: Sequence[str]) -> None:
    """Raise an error if the input has several time bases and the output can have only one.

    Raises
    ------
    UsageError
        If the output cannot have all time bases.
    """
    if len(groups) > 1 and not stores_several_times(format_to_write(output)):
        named = ", ".join(map(repr, groups[:_MOST_NAMED]))
        more = f" and {len(groups) - _MOST_NAMED} more" if len(groups) > _MOST_NAMED else ""
        raise UsageError(
            f"The file has channels at {len(groups)} times ({named}{more}), but {output} can have one; give"
            " an output that ends in .h5, .mat, .mf4, .npz or .tdms, or choose one time with --group."
        )


def with_time_column(output: Path, source: OpenSource, write: Callable[[pa.Table], None]) -> Callable[[pa.Table], None]:
    """Return a function that writes tables of a time base; it adds a time column if the output can have several."""
    form = format_to_write(output)
    return with_time(source, write, always=form == MF4) if stores_several_times(form) else write


def copy_other_groups(output: Path, opened: OpenFile, write: Callable[[pa.Table], None]) -> None:
    """Copy the groups that are not cleaned to an output that can have several time bases; else do nothing."""
    if stores_several_times(format_to_write(output)):
        for raw, _ in opened.passed_through:
            for block in raw.blocks(raw.names):
                write(block)


def print_time_bases(output: Path, opened: OpenFile) -> None:
    """Print the notes on a file, and the columns and groups that were not cleaned."""
    print_notes(*opened.sources)
    for source in opened.sources:
        print_columns(source)
    what = "Passed through unchanged" if stores_several_times(format_to_write(output)) else "Not written"
    for raw, why in opened.passed_through[:_MOST_NAMED]:
        stderr.print(f"{what}: {raw.group} ({why}).")
    if len(opened.passed_through) > _MOST_NAMED:
        stderr.print(f"{what}: {len(opened.passed_through) - _MOST_NAMED} more groups.")
