"""The benchmark of sinks runs, and finds every row that it wrote."""

from __future__ import annotations

import pytest

from live_sinks import table
from servers import need


@pytest.mark.slow
def test_every_sink_stands_beside_its_rival() -> None:
    """Small and untimed; the benchmark itself counts rows, and fails where some are missing."""
    need("initdb")
    lines = table(rows=20_000, repeats=1).splitlines()[2:]
    assert [line.split("|")[1].strip() for line in lines] == ["parquet", "delta", "postgres"]
