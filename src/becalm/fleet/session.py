"""Spark as a command line needs it: on this machine unless another master is named, and then only on loopback."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from becalm.errors import UsageError

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

HERE = "local[*]"
"""The master where none is named: all cores of this machine."""

_TRIES = 4  # of a task whose worker died, as on a cluster
_MASTER = re.compile(r"local(\[(\*|[1-9]\d*)(, *[1-9]\d*)?\])?|local-cluster\[.+\]|(spark|k8s)://.+|yarn")

_LOOPBACK = "127.0.0.1"
_RAISED = re.compile(r"(?:Caused by)?:? ?(?:org|java|scala)\.[\w.$]*(?:Exception|Error): (?P<says>.+)")
_PYTHON_RAISED = re.compile(r"[A-Za-z_][\w.]*(?:Error|Exception): .+")  # in a worker, as the last of its lines
_LONGEST = 300
_LOGS = f"-Dlog4j2.configurationFile={Path(__file__).with_name('log4j2.properties').as_uri()}"
_HARDLY_COMPILED = "-XX:TieredStopAtLevel=1"  # of a JVM that only schedules, better code would cost more than it gains
_QUIET = {
    "spark.ui.enabled": "false",  # a page that nobody asked for, open to all of the network
    "spark.ui.showConsoleProgress": "false",
    "spark.sql.session.timeZone": "UTC",
    # by a socket of loopback each task waits some time for nothing, and another user may speak with it
    "spark.python.unix.domain.socket.enabled": str(os.name == "posix").lower(),
}


@contextmanager
def session(
    master: str | None = None, settings: dict[str, str] | None = None, *, schedules: bool = False
) -> Iterator[SparkSession]:
    """Give a session of Spark, which ends in the end, unless there was one before.

    Parameters
    ----------
    master : str, optional
        As Spark has it: `local[4]`, `spark://host:7077`, `yarn`; `HERE` where none is named. A task whose worker died
        is tried four times, as on a cluster, but with `local[4,1]` once.
    settings : dict of str to str, optional
        Spark's own.
    schedules : bool
        Whether Spark only schedules, as for lakes that are cleaned or tuned, so that its JVM has little to do itself.

    Raises
    ------
    UsageError
        If pyspark, or Java, is not here, there is no such master, or this process has Spark on another one.
    """
    asked = master or HERE
    master, (builder, running) = _understood(asked), _builder()
    if running is not None and running.sparkContext.master not in (asked, master):
        raise UsageError(f"This process has Spark on {running.sparkContext.master}; stop it, or ask for that master.")
    told = _settings(master, schedules) | (settings or {})
    for name, value in told.items():
        builder = builder.config(name, value)
    try:
        spark: SparkSession = builder.master(master).appName("becalm").getOrCreate()
    except Exception as cause:  # what Spark raises here is of many kinds
        raise UsageError(f"Spark does not start on {master} ({reason_of(cause)}).{_advice(cause)}") from cause
    spark.sparkContext.setLogLevel("ERROR")
    try:
        yield spark
    finally:
        if running is None:
            _stop(spark)


def _stop(spark: SparkSession) -> None:
    """Stop Spark; where its JVM is gone, let pyspark forget it, or no other session could begin in this process."""
    from py4j.protocol import Py4JError
    from pyspark import SparkContext
    from pyspark.sql import SparkSession

    try:
        spark.stop()
    except (Py4JError, ConnectionError):
        SparkSession._instantiatedSession = None
        SparkContext._active_spark_context = SparkContext._gateway = SparkContext._jvm = None


def _understood(master: str) -> str:
    """Refuse what is no master; on this machine too, a task whose worker dies is tried again, unless told how often."""
    if not _MASTER.fullmatch(master):
        raise UsageError(
            f"--master {master} is no master of Spark's; give local[4], spark://HOST:7077 or yarn, or leave it out for"
            " this machine."
        )
    cores = re.fullmatch(r"local(?:\[(\*|\d+)\])?", master)
    return f"local[{cores[1] or 1},{_TRIES}]" if cores else master


def _builder() -> tuple[SparkSession.Builder, SparkSession | None]:
    """Return what builds a session, and the one that there is already."""
    try:
        from pyspark import SparkContext
        from pyspark.sql import SparkSession
    except ModuleNotFoundError as cause:
        raise UsageError("Spark is not here. Type: pip install 'becalm[spark]', and install Java 17.") from cause
    # whichever thread asks: a session is active in the one that made it, and stopping it would stop it for all
    there = SparkContext._active_spark_context is not None
    return SparkSession.builder, SparkSession.builder.getOrCreate() if there else None


def _settings(master: str, schedules: bool) -> dict[str, str]:
    """Return settings for a master; on this machine workers are this very Python, and nobody else is let in."""
    executor = _HARDLY_COMPILED if schedules else ""
    shared = {  # which stand before, and not in the place of, options that somebody has set
        "spark.driver.defaultJavaOptions": f"{_LOGS} {executor}".strip(),
        "spark.executor.defaultJavaOptions": executor,
    }
    if not master.startswith("local"):
        return _QUIET | shared
    os.environ.setdefault("PYSPARK_PYTHON", sys.executable)
    os.environ.setdefault("SPARK_LOCAL_IP", _LOOPBACK)
    return _QUIET | shared | {"spark.driver.host": _LOOPBACK, "spark.driver.bindAddress": _LOOPBACK}


def reason_of(cause: BaseException) -> str:
    """Return why Spark failed, in a line: what its JVM raised, without the name of its class, if that tells."""
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    if python := [line for line in lines if _PYTHON_RAISED.match(line) and not line.startswith(("java.", "org."))]:
        return python[-1][:_LONGEST].rstrip(".")
    raised = [match["says"] for match in map(_RAISED.match, lines) if match]
    return (raised[0] if raised else lines[0] if lines else type(cause).__name__)[:_LONGEST].rstrip(".")


def _advice(cause: BaseException) -> str:
    home = os.environ.get("JAVA_HOME")
    if shutil.which("java", path=str(Path(home) / "bin") if home else None) is None:
        return " It needs Java 17 or newer: install one (Debian: openjdk-17-jre-headless), or set JAVA_HOME."
    said = " Java, which must be 17 or newer, said why above." if "JAVA_GATEWAY_EXITED" in str(cause) else ""
    return f"{said} Name a master that is there with --master, as local[4] or spark://HOST:7077."
