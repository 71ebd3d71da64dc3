"""Find the intervals at rest of an accelerometer that lay in many poses, to calibrate it."""

from __future__ import annotations

import numpy as np

from becalm.core.recording import Recording
from becalm.errors import SensorError
from becalm.identification.at_rest.detection import SHORTEST_S, detect_rests
from becalm.sensors.poses import FEWEST_POSES, Rests

_AXES = 3
_BLOCKS = 8  # number of blocks of a rest: their means give the standard error of its mean, even for coloured noise


def find_rests(recording: Recording, shortest_s: float = SHORTEST_S) -> Rests:
    """Find the intervals at rest of a triaxial sensor, with the mean reading of each axis.

    Parameters
    ----------
    recording : Recording
        Readings of the three axes.
    shortest_s : float
        Shortest rest that counts, in seconds.

    Returns
    -------
    Rests
        The rests that have eight or more rows with readings of all axes, and in which the readings of each axis vary.

    Raises
    ------
    SensorError
        If there are not three channels.
    RecordingError
        If `shortest_s` is not positive.
    """
    if len(recording.names) != _AXES:
        raise SensorError(
            f"{len(recording.names)} channels came; a triaxial sensor has three. Select them (--channels)."
        )
    means, standard_errors = [], []
    for start, stop in detect_rests(recording, shortest_s).stretches:
        rest = recording.samples[start:stop]
        rest = rest[np.isfinite(rest).all(axis=1)]
        if len(rest) < _BLOCKS:
            continue
        blocks = np.array([block.mean(axis=0) for block in np.array_split(rest, _BLOCKS)])
        if (np.ptp(rest, axis=0) > 0).all():  # not the deviation of blocks: rounding lets equal means differ
            means.append(rest.mean(axis=0))
            standard_errors.append(blocks.std(axis=0, ddof=1) / np.sqrt(_BLOCKS))
    return Rests(np.reshape(means, (-1, _AXES)), np.reshape(standard_errors, (-1, _AXES)))


def find_poses(recording: Recording) -> Rests:
    """Find the rests of a triaxial sensor as `find_rests` does, and raise an error if they are too few.

    Raises
    ------
    SensorError
        If there are not three channels, the readings of one never change, or there are fewer than ten rests.
    """
    rests = find_rests(recording)
    for name, readings in zip(recording.names, recording.samples.T, strict=True):
        finite = readings[np.isfinite(readings)]
        if len(finite) and np.ptp(finite) == 0:
            raise SensorError(f"The readings of {name!r} never change; check its wiring, and record again.")
    if len(rests.means) < FEWEST_POSES:
        raise SensorError(
            f"{len(rests.means)} rests were found, but {FEWEST_POSES} are needed: "
            f"{detect_rests(recording).reason} Lay the sensor down in each pose for some seconds."
        )
    return rests
