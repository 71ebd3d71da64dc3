"""Whose a checkpoint and an output are: another stream would go on where it never was. Loaded only where Spark is."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from py4j.protocol import Py4JError
from pyspark.errors import PySparkException

from becalm.errors import OutputError
from becalm.fleet.session import reason_of
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
    with _told(plan):
        _refuse(_Folders(spark), plan)


def claim(spark: SparkSession, plan: StreamPlan) -> None:
    """Say in a checkpoint, which was not refused, of which stream it is.

    Parameters
    ----------
    spark : SparkSession
        As in `refuse_other`.
    plan : StreamPlan
        The stream.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    with _told(plan):
        folders, place = _Folders(spark), f"{plan.checkpoint_folder}/{_CLAIM}"
        own = json.dumps(_claim_of(plan))
        if folders.read(place) != own:
            folders.write(place, own)


@contextmanager
def _told(plan: StreamPlan) -> Iterator[None]:
    """Say in a sentence what Spark cannot do with folders."""
    try:
        yield
    except (Py4JError, PySparkException) as cause:
        raise OutputError(
            f"{plan.output}, or the checkpoint {plan.checkpoint_folder}, cannot be used ({reason_of(cause)}); name"
            " another."
        ) from cause


def _refuse(folders: _Folders, plan: StreamPlan) -> None:
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
    if kept and (before := folders.read(f"{plan.checkpoint_folder}/{_CLAIM}")):
        _refuse_changed(plan, before)


def _refuse_changed(plan: StreamPlan, before: str) -> None:
    try:
        told, own = json.loads(before), _claim_of(plan)
        changed = next((name for name in _WORDS if told[name] != own[name]), None)
    except (ValueError, KeyError, TypeError) as cause:
        raise OutputError(
            f"{plan.checkpoint_folder}/{_CLAIM} is damaged, and would say of which stream that checkpoint is; remove it"
            " if you know that it is of this one."
        ) from cause
    if changed is not None:
        raise OutputError(
            f"The checkpoint {plan.checkpoint_folder} is of a stream that was begun {_WORDS[changed]}"
            f" {told[changed]!r}, not {own[changed]!r}; begin it again as it was, or name another checkpoint and"
            " another output."
        )


def _claim_of(plan: StreamPlan) -> dict[str, str]:
    """Return what may not change of a stream; the server of its messages may."""
    source = plan.source
    if "://" in source:
        address = Address.parsed(plan.source)
        source = f"{address.kind}: {address.rest.rpartition('/')[2]}"
    return {"output": plan.output, "source": source, "key": plan.sensors.key, "time": plan.sensors.time}


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
        """Write a text, which is there whole or not at all."""
        files, place = self._found(path)
        _, beside = self._found(f"{path}.part")
        stream = files.create(beside, True)
        try:
            stream.write(bytearray(text.encode()))
        finally:
            stream.close()
        files.delete(place, False)
        files.rename(beside, place)

    def _found(self, path: str) -> tuple[Any, Any]:
        place = self._jvm.org.apache.hadoop.fs.Path(path)
        return place.getFileSystem(self._settings), place
