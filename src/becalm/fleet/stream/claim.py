"""Whose a checkpoint and an output are: another stream would go on where it never was. Loaded only where Spark is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from becalm.errors import OutputError
from becalm.fleet.stream.plan import StreamPlan
from becalm.live.address import Address

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

_CLAIM = "becalm.json"
_WORDS = {"output": "into", "source": "from", "key": "with --by", "time": "with --time"}


def refuse_other(spark: SparkSession, plan: StreamPlan) -> None:
    """Refuse a checkpoint that is of another stream, and an output that is.

    Parameters
    ----------
    spark : SparkSession
        Which finds the folders, on whichever file system they are.
    plan : StreamPlan
        The stream.

    Raises
    ------
    OutputError
        If the checkpoint or the output is of another stream, or no folder: Spark would leave out what it takes for
        written, or go on from places that this stream has never been at.
    """
    folders = _Folders(spark)
    for place in (plan.output, plan.checkpoint_folder):
        if folders.is_file(place):
            raise OutputError(f"{place} is a file; name a folder for the stream's output, and for its checkpoint.")
    told = folders.holds(f"{plan.output}/_spark_metadata")
    kept = folders.holds(f"{plan.checkpoint_folder}/offsets")
    done = folders.holds(f"{plan.checkpoint_folder}/commits")  # none where the first micro-batch was killed
    if told and not kept:
        raise OutputError(
            f"{plan.output} holds another stream, or this one without its checkpoint {plan.checkpoint_folder}; "
            "name another folder for the output, or the checkpoint that belongs to it."
        )
    if done and not told:
        raise OutputError(
            f"The checkpoint {plan.checkpoint_folder} is of a stream that does not write to {plan.output}; "
            "name another checkpoint, or the output that belongs to it."
        )
    before, own = folders.read(f"{plan.checkpoint_folder}/{_CLAIM}") if kept else "", _claim_of(plan)
    for name, word in _WORDS.items():
        if before and json.loads(before)[name] != own[name]:
            raise OutputError(
                f"The checkpoint {plan.checkpoint_folder} is of a stream that was begun {word} "
                f"{json.loads(before)[name]!r}, not {own[name]!r}; begin it again as it was, or name another "
                "checkpoint and output."
            )


def claim(spark: SparkSession, plan: StreamPlan) -> None:
    """Say in a checkpoint, which was not refused, of which stream it is.

    Parameters
    ----------
    spark : SparkSession
        As in `refuse_other`.
    plan : StreamPlan
        The stream.
    """
    _Folders(spark).write(f"{plan.checkpoint_folder}/{_CLAIM}", json.dumps(_claim_of(plan)))


def _claim_of(plan: StreamPlan) -> dict[str, str]:
    """Return what may not change of a stream; the server of its messages may."""
    source = _absolute(plan.source)
    if "://" in plan.source:
        address = Address.parsed(plan.source)
        source = f"{address.kind}: {address.rest.rpartition('/')[2]}"
    return {"output": _absolute(plan.output), "source": source, "key": plan.sensors.key, "time": plan.sensors.time}


def _absolute(place: str) -> str:
    return place if "://" in place else str(Path(place).resolve())


class _Folders:
    """Files as Spark finds them."""

    def __init__(self, spark: SparkSession) -> None:
        self._jvm: Any = spark._jvm
        self._settings: Any = spark._jsc.hadoopConfiguration()

    def is_file(self, path: str) -> bool:
        files, place = self._found(path)
        return bool(files.exists(place) and files.getFileStatus(place).isFile())

    def holds(self, path: str) -> bool:
        """Whether a folder is there and holds something."""
        files, place = self._found(path)
        return bool(files.exists(place) and len(files.listStatus(place)))

    def read(self, path: str) -> str:
        """Return a text; "" where it is not there."""
        files, place = self._found(path)
        if not files.exists(place):
            return ""
        stream = files.open(place)
        try:
            return str(self._jvm.org.apache.commons.io.IOUtils.toString(stream, "UTF-8"))
        finally:
            stream.close()

    def write(self, path: str, text: str) -> None:
        files, place = self._found(path)
        stream = files.create(place, True)
        try:
            stream.write(bytearray(text.encode()))
        finally:
            stream.close()

    def _found(self, path: str) -> tuple[Any, Any]:
        place = self._jvm.org.apache.hadoop.fs.Path(path)
        return place.getFileSystem(self._settings), place
