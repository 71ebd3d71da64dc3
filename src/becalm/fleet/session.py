"""Start Spark for the command line; by default on this machine, where only the loopback address reaches it."""

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
"""The default master: all cores of this machine."""

_TRIES = 4  # attempts at a task whose workers die; clusters use the same number
_MASTER = re.compile(r"local(\[(\*|[1-9]\d*)(, *[1-9]\d*)?\])?|local-cluster\[.+\]|(spark|k8s)://.+|yarn")

_LOOPBACK = "127.0.0.1"
_JAVA_EXCEPTION = re.compile(r"(?:Caused by)?:? ?(?:org|java|scala)\.[\w.$]*(?:Exception|Error): (?P<says>.+)")
_PYTHON_EXCEPTION = re.compile(r"[A-Za-z_][\w.]*(?:Error|Exception): .+")  # last line of a worker's traceback
_LONGEST = 300  # characters of Spark's reason in a message
_LOGS = f"-Dlog4j2.configurationFile={Path(__file__).with_name('log4j2.properties').as_uri()}"
_HARDLY_COMPILED = "-XX:TieredStopAtLevel=1"  # full compilation takes a JVM that only schedules longer than it saves
_QUIET = {
    "spark.ui.enabled": "false",  # the page would be open to the whole network
    "spark.ui.showConsoleProgress": "false",
    "spark.sql.session.timeZone": "UTC",
    # Unix sockets: a TCP socket would delay each task, and other users of the machine could connect to it
    "spark.python.unix.domain.socket.enabled": str(os.name == "posix").lower(),
}


@contextmanager
def session(
    master: str | None = None, settings: dict[str, str] | None = None, *, schedules: bool = False
) -> Iterator[SparkSession]:
    """Provide a Spark session in a `with`. At the end, the session stops, unless it was running before.

    Parameters
    ----------
    master : str, optional
        A Spark master: `local[4]`, `spark://host:7077`, `yarn`; `HERE` by default. A task whose worker dies is tried
        up to four times; with `local[4,1]` it is tried once.
    settings : dict of str to str, optional
        Additional Spark settings, by name.
    schedules : bool
        Whether Spark only schedules tasks, as for cleaning or tuning a lake; the JVM then starts with less compilation.

    Raises
    ------
    UsageError
        If pyspark or Java is not installed, there is no such master, or this process runs Spark on another master.
    """
    requested = master or HERE
    master, (builder, running) = _checked_master(requested), _builder()
    if running is not None and running.sparkContext.master not in (requested, master):
        raise UsageError(f"This process has Spark on {running.sparkContext.master}; stop it, or name that master.")
    options = _settings(master, schedules) | (settings or {})
    for name, value in options.items():
        builder = builder.config(name, value)
    try:
        spark: SparkSession = builder.master(master).appName("becalm").getOrCreate()
    except Exception as cause:  # Spark raises many types here
        raise UsageError(f"Spark does not start on {master} ({reason_of(cause)}).{_advice(cause)}") from cause
    spark.sparkContext.setLogLevel("ERROR")
    try:
        yield spark
    finally:
        if running is None:
            _stop(spark)


def _stop(spark: SparkSession) -> None:
    """Stop Spark; if its JVM has ended, clear pyspark's references to it, so that this process can start a new JVM."""
    from py4j.protocol import Py4JError
    from pyspark import SparkContext
    from pyspark.sql import SparkSession

    try:
        spark.stop()
    except (Py4JError, ConnectionError):
        SparkSession._instantiatedSession = None
        SparkContext._active_spark_context = SparkContext._gateway = SparkContext._jvm = None


def _checked_master(master: str) -> str:
    """Check the name of a master, and return it; add the number of attempts to a local master that has none."""
    if not _MASTER.fullmatch(master):
        raise UsageError(
            f"--master {master} is not a Spark master; give local[4], spark://HOST:7077 or yarn, or omit it to use this"
            " machine."
        )
    cores = re.fullmatch(r"local(?:\[(\*|\d+)\])?", master)
    return f"local[{cores[1] or 1},{_TRIES}]" if cores else master


def _builder() -> tuple[SparkSession.Builder, SparkSession | None]:
    """Return Spark's session builder, and the session that already runs, if any."""
    try:
        from pyspark import SparkContext
        from pyspark.sql import SparkSession
    except ModuleNotFoundError as cause:
        raise UsageError("Spark is not installed. Type: pip install 'becalm[spark]', and install Java 17.") from cause
    # check the context, which all threads share; a session is active only in the thread that made it
    there = SparkContext._active_spark_context is not None
    return SparkSession.builder, SparkSession.builder.getOrCreate() if there else None


def _settings(master: str, schedules: bool) -> dict[str, str]:
    """Return Spark settings; a local master runs workers with this Python and listens on the loopback address only."""
    executor = _HARDLY_COMPILED if schedules else ""
    shared = {  # Spark places these before the user's options, so the user's options take precedence
        "spark.driver.defaultJavaOptions": f"{_LOGS} {executor}".strip(),
        "spark.executor.defaultJavaOptions": executor,
    }
    if not master.startswith("local"):
        return _QUIET | shared
    os.environ.setdefault("PYSPARK_PYTHON", sys.executable)
    os.environ.setdefault("SPARK_LOCAL_IP", _LOOPBACK)
    return _QUIET | shared | {"spark.driver.host": _LOOPBACK, "spark.driver.bindAddress": _LOOPBACK}


def reason_of(cause: BaseException) -> str:
    """Return one line on why Spark failed: the message of the Python or Java exception, or else the first line."""
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    if python := [line for line in lines if _PYTHON_EXCEPTION.match(line) and not line.startswith(("java.", "org."))]:
        return python[-1][:_LONGEST].rstrip(".")
    raised = [match["says"] for match in map(_JAVA_EXCEPTION.match, lines) if match]
    return (raised[0] if raised else lines[0] if lines else type(cause).__name__)[:_LONGEST].rstrip(".")


def _advice(cause: BaseException) -> str:
    home = os.environ.get("JAVA_HOME")
    if shutil.which("java", path=str(Path(home) / "bin") if home else None) is None:
        return " It needs Java 17 or newer: install one (Debian: openjdk-17-jre-headless), or set JAVA_HOME."
    java = " Java, which must be 17 or newer, printed the reason above." if "JAVA_GATEWAY_EXITED" in str(cause) else ""
    return f"{java} Name an existing master with --master, such as local[4] or spark://HOST:7077."
