"""What Spark says when it fails, in a line that a person can use."""

from __future__ import annotations

import pytest

from becalm.fleet.session import reason_of

STARTING = """An error occurred while calling None.org.apache.spark.api.java.JavaSparkContext.
: org.apache.spark.SparkException: Could not parse Master URL: 'nonsense'
\tat org.apache.spark.SparkContext$.org$apache$spark$SparkContext$$createTaskScheduler(SparkContext.scala:1)
"""
WORKERS = """[JOB_ABORTED] Job aborted due to stage failure: Task 3 failed 4 times.
Caused by: java.io.EOFException: Python worker exited unexpectedly (crashed)
"""


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        (STARTING, "Could not parse Master URL: 'nonsense'"),
        (WORKERS, "Python worker exited unexpectedly (crashed)"),
        ("[JAVA_GATEWAY_EXITED] Java gateway process exited.", "[JAVA_GATEWAY_EXITED] Java gateway process exited"),
        ("", "ValueError"),
    ],
)
def test_the_reason_is_what_was_raised(said: str, reason: str) -> None:
    assert reason_of(ValueError(said)) == reason
