"""Check that a checkpoint and an output belong to this stream, and mark the checkpoint. This module needs Spark.

With the checkpoint of another stream, Spark would continue from the other stream's position.
"""

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

_CLAIM = "becalm.json"  # file in a checkpoint with the options of its stream that must not change
_WORDS = {"output": "into", "source": "from", "key": "with --by", "time": "with --time"}  # before values in messages


def refuse_other(spark: SparkSession, plan: StreamPlan) -> None:
    """Raise an error if the checkpoint or the output belongs to another stream.

    Parameters
    ----------
    spark : SparkSession
        The Spark session; it reads the folders, on any file system.
    plan : StreamPlan
        The stream.

    Raises
    ------
    OutputError
        If the checkpoint or the output belongs to another stream, or is not a folder.
    """
    with _as_output_error(plan):
        _refuse(_Folders(spark), plan)


def claim(spark: SparkSession, plan: StreamPlan) -> None:
    """Write into a checkpoint which stream it belongs to; call `refuse_other` first.

    Parameters
    ----------
    spark : SparkSession
        The Spark session; it writes the file.
    plan : StreamPlan
        The stream.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with _as_output_error(plan):
        folders, place = _Folders(spark), f"{plan.checkpoint_folder}/{_CLAIM}"
        own = json.dumps(_claim_of(plan))
        if folders.read(place) != own:
            folders.write(place, own)


@contextmanager
def _as_output_error(plan: StreamPlan) -> Iterator[None]:
    """Raise an OutputError that names the folders for each error of Spark in the `with`."""
    try:
        yield
    except (Py4JError, PySparkException) as cause:
        raise OutputError(
            f"{plan.output}, or the checkpoint {plan.checkpoint_folder}, cannot be used ({reason_of(cause)}); name"
            " another folder."
        ) from cause


def _refuse(folders: _Folders, plan: StreamPlan) -> None:
    for place in (plan.output, plan.checkpoint_folder):
        if folders.is_file(place):
            raise OutputError(f"{place} is a file; name a folder for the stream's output, and for its checkpoint.")
    has_output = folders.holds(f"{plan.output}/_spark_metadata")
    has_offsets = folders.holds(f"{plan.checkpoint_folder}/offsets")
    has_commits = folders.holds(f"{plan.checkpoint_folder}/commits")  # false if the first micro-batch was killed
    if has_output and not has_offsets:
        raise OutputError(
            f"{plan.output} holds another stream, or this one without its checkpoint {plan.checkpoint_folder}; "
            "name another folder for the output, or the checkpoint that belongs to it."
        )
    if has_commits and not has_output:
        raise OutputError(
            f"The checkpoint {plan.checkpoint_folder} belongs to a stream that does not write to {plan.output}; "
            "name another checkpoint, or the output that belongs to it."
        )
    if has_offsets and (before := folders.read(f"{plan.checkpoint_folder}/{_CLAIM}")):
        _refuse_changed(plan, before)


def _refuse_changed(plan: StreamPlan, before: str) -> None:
    try:
        stored, own = json.loads(before), _claim_of(plan)
        changed = next((name for name in _WORDS if stored[name] != own[name]), None)
    except (ValueError, KeyError, TypeError) as cause:
        raise OutputError(
            f"{plan.checkpoint_folder}/{_CLAIM}, which says which stream the checkpoint belongs to, is damaged; remove"
            " this file if you know that the checkpoint belongs to this stream."
        ) from cause
    if changed is not None:
        raise OutputError(
            f"The checkpoint {plan.checkpoint_folder} belongs to a stream that was started {_WORDS[changed]}"
            f" {stored[changed]!r}, not {own[changed]!r}; start it as before, or name another checkpoint and"
            " another output."
        )


def _claim_of(plan: StreamPlan) -> dict[str, str]:
    """Return the options of a stream that must not change; the server part of a message source may change."""
    source = plan.source
    if "://" in source:
        address = Address.parsed(plan.source)
        source = f"{address.kind}: {address.rest.rpartition('/')[2]}"
    return {"output": plan.output, "source": source, "key": plan.sensors.key, "time": plan.sensors.time}


class _Folders:
    """Access to files and folders through Spark's file systems."""

    def __init__(self, spark: SparkSession) -> None:
        self._jvm: Any = spark._jvm
        self._settings: Any = spark._jsc.hadoopConfiguration()

    def is_file(self, path: str) -> bool:
        files, place = self._located(path)
        return bool(files.exists(place) and files.getFileStatus(place).isFile())

    def holds(self, path: str) -> bool:
        """Return whether a folder exists and is not empty."""
        files, place = self._located(path)
        return bool(files.exists(place) and len(files.listStatus(place)))

    def read(self, path: str) -> str:
        """Return the text of a file, or "" if it does not exist."""
        files, place = self._located(path)
        if not files.exists(place):
            return ""
        stream = files.open(place)
        try:
            return str(self._jvm.org.apache.commons.io.IOUtils.toString(stream, "UTF-8"))
        finally:
            stream.close()

    def write(self, path: str, text: str) -> None:
        """Write a text to a temporary file and rename that file, so that the target is never partial."""
        files, place = self._located(path)
        _, part = self._located(f"{path}.part")
        stream = files.create(part, True)
        try:
            stream.write(bytearray(text.encode()))
        finally:
            stream.close()
        files.delete(place, False)
        files.rename(part, place)

    def _located(self, path: str) -> tuple[Any, Any]:
        place = self._jvm.org.apache.hadoop.fs.Path(path)
        return place.getFileSystem(self._settings), place
