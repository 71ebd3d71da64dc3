"""The likelihood of a record and nothing else: what tuning asks for, dozens of times a channel."""

from __future__ import annotations

from numpy.typing import ArrayLike

from becalm.core import starting
from becalm.core.arrays import Floats
from becalm.core.filtering import Sums, Wanted, checked_readings, new_trace, run_filter, sizes_of
from becalm.core.kernel_settling import GAIN, new_memory
from becalm.core.kernels import forward
from becalm.core.model import Model
from becalm.core.timeline import Timeline, even_timeline

NOTHING = Wanted(sigma=False, innovations=False, signal=False)


def log_likelihood(model: Model, z: ArrayLike) -> float:
    """Return the exact Gaussian log-likelihood of readings; see `kalman_filter`.

    Parameters
    ----------
    model : Model
        The signal and its sensors, one step a row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units, NaN where one did not arrive.

    Raises
    ------
    ModelError
        If z does not fit the model, or the model cannot start without x0 and P0.

    Notes
    -----
    Schweppe, IEEE TIT-11 (1965) 61; equation (8) of `becalm.core.reference`.
    """
    readings = checked_readings(model, z)
    return run_filter(model, even_timeline(model, len(readings)), readings, NOTHING).estimate.log_likelihood


def score(model: Model, timeline: Timeline, z: Floats, scored_from: int) -> Sums | None:
    """Return what makes the likelihood of the rows from `scored_from` on, after a start from the first readings.

    None where the readings (N, m) do not tell the state.
    """
    opening = starting.open_record(timeline, z, model)
    if not opening.known or opening.rows >= len(z):
        return None
    memory, trace = new_memory(opening.x, opening.P, model.channels), new_trace(model, len(z), NOTHING)
    begun = opening.rows
    if begun < scored_from:
        head = timeline.record(z[:scored_from])
        forward(sizes_of(model), timeline.system, head, begun, GAIN, memory, trace)
        begun = scored_from
    squares, log_det, used, _ = forward(
        sizes_of(model), timeline.system, timeline.record(z), begun, GAIN, memory, trace
    )
    return Sums(squares, log_det, used)
