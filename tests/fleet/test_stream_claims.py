"""A checkpoint and an output are of one stream: another is refused, and what could not be read or named is said."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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


def test_a_checkpoint_and_an_output_are_of_one_stream(stage: Stage, spark: SparkSession, tmp_path: Path) -> None:
    """Whatever files and folders are called, and however old they are."""
    stage.lake = stage.lake.parent / "l[5] {a,b} *"
    rows = cut(rows_of(200), [100])
    stage.write("sensor=s/0.PARQUET", rows[0])
    stage.once()
    shutil.copytree(stage.out, tmp_path / "other")
    stage.write("sensor=s/1.parquet", rows[1])
    os.utime(stage.lake / "sensor=s" / "1.parquet", (0, 0))  # as archives without dates unpack it
    other = str(tmp_path / "other" / "_checkpoint")
    refused(stage, spark, r"started into .*out', not .*other'; start it as before", output=str(tmp_path / "other"))
    refused(stage, spark, "was started with --by 'sensor', not 'plant'", {"key": "plant"})
    refused(stage, spark, "was started from", source=str(tmp_path))
    refused(stage, spark, r"is a file; name a folder", checkpoint=str(stage.recipe))
    refused(stage, spark, r"is a file; name a folder", output=str(stage.recipe))
    another = "holds another stream, or this one without its checkpoint"
    refused(stage, spark, another, checkpoint=str(tmp_path / "another"))
    (tmp_path / "third").mkdir()
    for output in (tmp_path / "third", tmp_path / "fourth"):
        says = "belongs to a stream that does not write to"
        refused(stage, spark, says, output=str(output), checkpoint=other)
    claim = stage.out / "_checkpoint" / "becalm.json"
    whole = claim.read_text(encoding="utf-8")
    claim.write_text(whole[:20], encoding="utf-8")
    refused(stage, spark, r"cannot be used \(Checksum error")
    claim.with_name(".becalm.json.crc").unlink()
    refused(stage, spark, r"becalm\.json, which says which stream the checkpoint belongs to, is damaged")
    claim.unlink()
    stage.once()
    assert claim.read_text(encoding="utf-8") == whole
    assert told_in(stage.out, "s").num_rows == 200
