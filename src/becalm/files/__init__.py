"""Read recordings in the format that their content shows, and write them in the format that the name's ending gives."""

from becalm.files.atomic_file import replace_file
from becalm.files.inputs.opening import Chunk, OpenSource, open_source, read, read_source
from becalm.files.outputs.tables import CleanChannel, output_block, output_table, recording_table
from becalm.files.outputs.writing import TableOutput, open_output, write, write_table
from becalm.files.read_options import ReadOptions
from becalm.files.source import ColumnLayout, Layout, SourceFile

__all__ = [
    "Chunk",
    "CleanChannel",
    "ColumnLayout",
    "Layout",
    "OpenSource",
    "ReadOptions",
    "SourceFile",
    "TableOutput",
    "open_output",
    "open_source",
    "output_block",
    "output_table",
    "read",
    "read_source",
    "recording_table",
    "replace_file",
    "write",
    "write_table",
]
