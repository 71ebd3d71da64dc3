"""Streams through Spark itself: from a lake into a lake, to the bit what a live stream tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import becalm
from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import InputError, OutputError, UsageError
from becalm.fleet.stream import LiveBook, SensorPlan, cleaned, run, wait
from becalm.fleet.stream.blocks import SensorRows
from becalm.live.address import Address
from made import recipe_of
from streaming import (
    OTHER,
    assert_same_bits,
    by_stream,
    cut,
    part,
    rows_of,
)
from streaming_spark import Stage, events_of, said_in, spark, stage, told_in, until

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

pytestmark = [pytest.mark.slow, pytest.mark.spark]
__all__ = ["spark", "stage"]


def test_a_lake_is_streamed_to_the_bit_whenever_its_files_come(stage: Stage, spark: SparkSession) -> None:
    """Beside rubbish, which stops nobody; settings of the session stay."""
    before, rows = dict(spark.conf.getAll), {f"{k:03d}": rows_of(900, k) for k in range(3)}
    stage.write("sensor=bad/0.parquet", SensorRows(np.zeros(50), np.full((50, 2), np.inf)))
    (stage.lake / "sensor=bad" / "1.parquet").write_bytes(b"rubbish")
    for number in range(3):
        for sensor, whole in rows.items():
            ending = "parquet" if number else "PARQUET"
            how = {"stamps": pa.timestamp("ns", "UTC")} if sensor == "002" else {}
            stage.write(f"sensor={sensor}/part-{9 - number}.{ending}", cut(whole, [300, 600])[number], **how)
        if number:
            stage.once()
    for sensor, whole in rows.items():
        table = told_in(stage.out, sensor)
        assert_same_bits(said_in(table), by_stream(whole))
        assert table.column_names[:4] == ["time", "a", "a_sigma", "a_verdict"]
        assert table["time"].type == pa.timestamp("us", "UTC")
        assert len(set(table["recipe"].to_pylist())) == 1
        assert told_in(stage.out, sensor, "events")["event"].to_pylist() == ["gap", "gap"]
    recording = becalm.read(stage.out / "kind=readings" / "sensor=001")
    assert len(recording) == 900
    np.testing.assert_array_equal(recording.channel("a"), by_stream(rows["001"]).signal[:, 0])
    events = told_in(stage.out, "bad", "events")
    assert set(events["event"].to_pylist()) == {"garbled", "repeated"}
    assert any("1.parquet is not a Parquet file" in says for says in events["says"].to_pylist())
    assert dict(spark.conf.getAll) == before


def test_blocks_stay_blocks(stage: Stage) -> None:
    rows = rows_of(600)
    stage.write("sensor=s/part-0.parquet", part(rows, slice(0, 300)), block=50)
    stage.write("sensor=s/part-1.parquet", part(rows, slice(300, 600)), block=70)
    stage.once()
    table = told_in(stage.out, "s")
    assert pa.types.is_list(table["a"].type)
    flat = pa.table({name: table[name].combine_chunks().flatten() for name in table.column_names[:7]})
    assert_same_bits(said_in(flat), by_stream(rows))


def test_seconds_and_another_key_do_too_and_a_name_too_long_for_a_folder_stops_nobody(stage: Stage) -> None:
    rows = rows_of(300)
    columns = {"pump": ["7", "s" * 300] * 150, "t": rows.time_s, "b": rows.values[:, 1]}
    stage.recipe.write_text(recipe_of("b").to_toml(), encoding="utf-8")
    stage.lake.mkdir()
    pq.write_table(pa.table(columns), stage.lake / "x.parquet")
    stage.once(key="pump", time="t")
    (place,) = (stage.out / "kind=readings").rglob("*.parquet")
    assert place.parent.name == "pump=7"
    table, own = pq.read_table(place, partitioning=None), part(rows, slice(0, None, 2))
    np.testing.assert_array_equal(table["t"].to_numpy(), own.time_s)
    np.testing.assert_array_equal(table["b"].to_numpy(), by_stream(own).signal[:, 1])
    (log,) = (stage.out / "kind=events" / "pump=__HIVE_DEFAULT_PARTITION__").glob("*.parquet")
    (event,) = pq.read_table(log, partitioning=None).to_pylist()
    assert (event["event"], event["event_rows"]) == ("refused", 150)
    assert "The sensor name that begins with 'ssss" in event["says"]


def test_another_recipe_takes_over_while_it_runs(stage: Stage) -> None:
    for number, rows in enumerate(cut(rows_of(1200), [300])):
        stage.write(f"sensor=s/{number}.parquet", rows)
        stage.once()
        stage.recipe.write_text(OTHER.to_toml(), encoding="utf-8")
    table = told_in(stage.out, "s")
    assert len(set(table["recipe"].to_pylist())) == 2
    assert "recipe" in told_in(stage.out, "s", "events")["event"].to_pylist()
    np.testing.assert_allclose(said_in(table).signal[-100:], by_stream(rows_of(1200), OTHER).signal[-100:], rtol=1e-6)


def test_rows_that_spark_has_already_are_filtered_for_any_sink(stage: Stage, spark: SparkSession) -> None:
    """In a zone of time that is not the default."""
    spark, rows = spark.newSession(), rows_of(300)
    for number, batch in enumerate(cut(rows, [100])):
        stage.write(f"sensor=00{number}/0.parquet", batch)
    frame = spark.readStream.schema("time timestamp, a double, b double, sensor string").parquet(str(stage.lake))
    spark.conf.set("spark.sql.session.timeZone", "Asia/Kolkata")
    told = cleaned(frame.withColumn("b", frame["b"].cast("decimal(30, 12)")), stage.plan().sensors)
    writer = told.writeStream.format("memory").queryName("told").trigger(availableNow=True)
    writer.option("checkpointLocation", str(stage.out)).start().awaitTermination()
    kept = spark.table("told").where("kind = 'readings' AND sensor = '001'").toArrow()
    assert (kept["time"].cast(pa.int64()).to_numpy() / 1e6 == rows.time_s[100:]).all()


def test_silence_is_said_while_the_stream_runs(stage: Stage, spark: SparkSession) -> None:
    rows = rows_of(200)
    stage.write("sensor=s/0.parquet", part(rows, slice(0, 100)))
    query = run(spark, stage.plan({"silent_s": 1.0}, every_s=0.5))
    try:
        until(lambda: events_of(stage.out, "s") == ["gap", "silent"])
        stage.write("sensor=s/1.parquet", part(rows, slice(100, 200)))
        until(lambda: events_of(stage.out, "s").count("silent") == 2)
    finally:
        query.stop()
    assert events_of(stage.out, "s").count("back") == 1
    assert_same_bits(said_in(told_in(stage.out, "s")), by_stream(rows))


def test_an_output_in_its_lake_and_a_source_of_another_kind_are_refused(stage: Stage, spark: SparkSession) -> None:
    stage.write("sensor=s/0.parquet", rows_of(50))
    with pytest.raises(OutputError, match="would be read again"):
        run(spark, replace(stage.plan(), output=str(stage.lake / "out")))
    assert not (stage.lake / "out").exists()
    with pytest.raises(UsageError, match="not a source of a fleet"):
        run(spark, stage.plan(source="mqtt://127.0.0.1/pumps"))


def test_sources_that_are_not_there_are_told(stage: Stage, spark: SparkSession) -> None:
    with pytest.raises(InputError, match="is not a folder"):
        stage.once()
    stage.lake.mkdir()
    with pytest.raises(InputError, match="holds no Parquet file yet"):
        stage.once()
    with pytest.raises(UsageError, match=r"spark-sql-kafka-0-10_2\.13:4"):
        run(spark, stage.plan({"channels": ("a",)}, source="kafka://127.0.0.1:9/pumps"))
    with pytest.raises(UsageError, match="names no servers and topic"):
        run(spark, stage.plan(source="kafka://127.0.0.1:9"))
    with pytest.raises(UsageError, match="no option 'topic'"):
        run(spark, stage.plan(source="kafka://127.0.0.1:9/pumps?topic=x"))


def test_messages_need_their_columns(spark: SparkSession) -> None:
    frame = spark.createDataFrame([("s", b"")], "sensor string, message binary")
    plan = SensorPlan(LiveBook(Path("r.toml")), channels=("a",), messages=Address.parsed("kafka://a/b"))
    with pytest.raises(UsageError, match="'place' is missing"):
        cleaned(frame, plan)


def test_a_stream_that_fails_says_why_in_a_sentence(stage: Stage, spark: SparkSession) -> None:
    class Broken:
        def channels(self) -> tuple[str, ...]:
            return ("a",)

        def recipe_for(self, sensor: str) -> Recipe:
            raise RuntimeError(f"a bug with {sensor}")

    stage.write("sensor=s/0.parquet", rows_of(50))
    plan = stage.plan(once=True)
    with pytest.raises(
        InputError, match=r"^The stream ended: a bug with s\. Estimates .* stay; start the stream again\.$"
    ):
        wait(run(spark, replace(plan, sensors=SensorPlan(Broken()))))
