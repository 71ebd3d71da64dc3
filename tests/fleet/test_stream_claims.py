"""A checkpoint and an output are of one stream: another is refused, and what could not be read or named is said."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import OutputError
from becalm.fleet.stream import run
from streaming import cut, rows_of
from streaming_spark import Stage, spark, stage, told_in

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

pytestmark = [pytest.mark.slow, pytest.mark.spark]
__all__ = ["spark", "stage"]


def refused(stage: Stage, spark: SparkSession, says: str, sensors: dict[str, Any] | None = None, **how: Any) -> None:
    plan = replace(stage.plan(sensors, once=True), **how)
    with pytest.raises(OutputError, match=says):
        run(spark, plan)


def test_a_checkpoint_is_of_one_stream(stage: Stage, spark: SparkSession, tmp_path: Path) -> None:
    rows = cut(rows_of(200), [100])
    stage.write("sensor=s/0.parquet", rows[0])
    stage.once()
    shutil.copytree(stage.out, tmp_path / "other")
    stage.write("sensor=s/1.parquet", rows[1])
    other = str(tmp_path / "other" / "_checkpoint")
    refused(stage, spark, r"started into .*out', not .*other'; start it as before", output=str(tmp_path / "other"))
    refused(stage, spark, "was started with --by 'sensor', not 'plant'", {"key": "plant"})
    refused(stage, spark, "was started from", source=str(tmp_path))
    refused(stage, spark, r"is a file; name a folder", checkpoint=str(stage.recipe))
    refused(stage, spark, r"is a file; name a folder", output=str(stage.recipe))
    (tmp_path / "third").mkdir()
    refused(
        stage, spark, "belongs to a stream that does not write to", output=str(tmp_path / "third"), checkpoint=other
    )
    stage.once()
    assert told_in(stage.out, "s").num_rows == 200


def test_a_damaged_claim_is_said(stage: Stage, spark: SparkSession) -> None:
    stage.write("sensor=s/0.parquet", rows_of(100))
    stage.once()
    claim = stage.out / "_checkpoint" / "becalm.json"
    whole = claim.read_text(encoding="utf-8")
    claim.write_text(whole[:20], encoding="utf-8")
    refused(stage, spark, r"cannot be used \(Checksum error")
    claim.with_name(".becalm.json.crc").unlink()
    refused(stage, spark, r"becalm\.json, which says which stream the checkpoint belongs to, is damaged")
    claim.unlink()
    stage.once()
    assert claim.read_text(encoding="utf-8") == whole


def test_whatever_files_and_folders_are_called(stage: Stage) -> None:
    stage.lake = stage.lake.parent / "l[5] {a,b} *"
    rows = cut(rows_of(400), [100, 200, 300])
    stage.write("sensor=s/0.PARQUET", rows[0])
    stage.once()
    stage.write("sensor=s/1.parquet", rows[1])
    os.utime(stage.lake / "sensor=s" / "1.parquet", (0, 0))  # as archives without dates unpack it
    stage.once()
    assert told_in(stage.out, "s").num_rows == 200


def test_a_name_too_long_for_a_folder_stops_nobody(stage: Stage) -> None:
    rows = rows_of(200)
    stage.lake.mkdir()
    columns = {"sensor": ["good", "s" * 300] * 100, "time": rows.time_s, "a": rows.values[:, 0], "b": rows.values[:, 1]}
    pq.write_table(pa.table(columns), stage.lake / "x.parquet")
    stage.once()
    assert told_in(stage.out, "good").num_rows == 100
    (event,) = told_in(stage.out, "__HIVE_DEFAULT_PARTITION__", "events").to_pylist()
    assert (event["event"], event["event_rows"]) == ("refused", 100)
    assert "The sensor name that begins with 'ssss" in event["says"]
