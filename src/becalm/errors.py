"""The family of errors: each is a sentence with a way out, and knows its exit code."""

from __future__ import annotations

NOT_DESCRIBED = 4
"""Exit code where all was written, but a model does not describe its channel: a finding, and no error."""


class BecalmError(Exception):
    """Anything a person can mend; the message says what came, what was needed and what to type."""

    exit_code = 2


class UsageError(BecalmError):
    """The command or call asks for something that cannot be done."""


class ModelError(UsageError, ValueError):
    """A matrix of a model has the wrong shape or is not what its name promises."""


class RecordingError(UsageError, ValueError):
    """Samples, names, units or times do not make one recording."""


class RecipeError(UsageError, ValueError):
    """A recipe cannot be read, or does not fit the recording."""


class SensorError(UsageError, ValueError):
    """What is said of a sensor is impossible, cannot be read, or does not fit the readings."""


class OutputError(UsageError):
    """The output cannot be written; nothing was left behind."""


class InputError(BecalmError):
    """The input cannot be read, or can be read in more than one way."""

    exit_code = 3


class TimeError(InputError, ValueError):
    """The time column cannot serve as time."""
