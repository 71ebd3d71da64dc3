"""Files: recordings in, recordings out; CSV, CSV.GZ and Parquet, found by content and by ending."""

from becalm.files.reading import read, read_source
from becalm.files.source import ColumnLayout, Layout, ReadOptions, SourceFile
from becalm.files.writing import output_table, recording_table, replace_file, write, write_table

__all__ = [
    "ColumnLayout",
    "Layout",
    "ReadOptions",
    "SourceFile",
    "output_table",
    "read",
    "read_source",
    "recording_table",
    "replace_file",
    "write",
    "write_table",
]
