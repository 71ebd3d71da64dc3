"""The exceptions of becalm; each message says what to do, and each class has an exit code."""

from __future__ import annotations

NOT_DESCRIBED = 4
"""Exit code if all output was written, but a model does not describe its channel; this is not an error."""


class BecalmError(Exception):
    """An error that the user can correct; the message says what came, what is needed and what to type."""

    exit_code = 2


class UsageError(BecalmError):
    """The arguments of a command or call are not valid."""


class ModelError(UsageError, ValueError):
    """A matrix of a model has a wrong shape or invalid values."""


class RecordingError(UsageError, ValueError):
    """Samples, names, units and times do not fit together."""


class RecipeError(UsageError, ValueError):
    """A recipe cannot be read, or does not fit the recording."""


class SensorError(UsageError, ValueError):
    """The description of a sensor is impossible, cannot be read, or does not fit the readings."""


class OutputError(UsageError):
    """The output cannot be written; no partial file remains."""


class InputError(BecalmError):
    """The input cannot be read, or can be read in more than one way."""

    exit_code = 3


class TimeError(InputError, ValueError):
    """The time column does not hold valid times."""
