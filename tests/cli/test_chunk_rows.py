"""How many rows are held at once: fewer where each has step matrices of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from becalm.core.arrays import BLOCK, Floats
from becalm.files import OpenSource, open_source
from becalm.files.inputs.portions import TUNED_ROWS, TUNED_ROWS_UNEVEN, rows_to_tune_on
from becalm.files.outputs.chunked_cleaning import CHUNK_ROWS, rows_of_chunks


def opened(folder: Path, times: Floats) -> OpenSource:
    noise = np.random.default_rng(1).normal(size=times.size)
    pq.write_table(pa.table({"time_s": times, "a": noise}), folder / "in.parquet")
    return open_source(folder / "in.parquet")


def test_even_time_goes_in_large_chunks_for_any_number_of_channels(tmp_path: Path) -> None:
    for times in (np.arange(300) / 100, np.delete(np.arange(300) / 100, [7, 8, 200])):
        with opened(tmp_path, times) as source:
            assert [rows_of_chunks(source, channels) for channels in (1, 12, 1000)] == [CHUNK_ROWS] * 3
            assert rows_to_tune_on(source) == TUNED_ROWS


def test_uneven_time_goes_in_small_chunks_of_whole_blocks(tmp_path: Path) -> None:
    with opened(tmp_path, np.cumsum(np.random.default_rng(2).exponential(size=300))) as source:
        rows = [rows_of_chunks(source, channels) for channels in (1, 4, 12, 1000)]
        assert rows == [CHUNK_ROWS // 4, CHUNK_ROWS // 4, 85 * BLOCK, 16 * BLOCK]
        assert rows_to_tune_on(source) == TUNED_ROWS_UNEVEN
