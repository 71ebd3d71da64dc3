"""Find the rests of an accelerometer that lay in many poses, to calibrate it."""

from __future__ import annotations

import numpy as np

from becalm.core.recording import Recording
from becalm.errors import SensorError
from becalm.identification.at_rest.detection import SHORTEST_S, detect_rests
from becalm.sensors.poses import FEWEST_POSES, Rests

_AXES = 3
_BLOCKS = 8  # number of blocks of a rest: their means give the standard error of its mean, even for coloured noise


def find_rests(recording: Recording, shortest_s: float = SHORTEST_S) -> Rests:
    """Find the rests of a triaxial sensor, with the mean reading of each axis.

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
        raise SensorError(f"{len(recording.names)} channels came; a triaxial sensor has three. Select these.")
    means, stds = [], []
    for start, stop in detect_rests(recording, shortest_s).stretches:
        rest = recording.samples[start:stop]
        rest = rest[np.isfinite(rest).all(axis=1)]
        if len(rest) < _BLOCKS:
            continue
        blocks = np.array([block.mean(axis=0) for block in np.array_split(rest, _BLOCKS)])
        std = blocks.std(axis=0, ddof=1) / np.sqrt(_BLOCKS)
        if (std > 0).all():
            means.append(rest.mean(axis=0))
            stds.append(std)
    return Rests(np.reshape(means, (-1, _AXES)), np.reshape(stds, (-1, _AXES)))


def find_poses(recording: Recording) -> Rests:
    """Find the rests of a triaxial sensor as `find_rests` does, and raise an error if they are too few.

    Raises
    ------
    SensorError
        If there are not three channels, or fewer than ten rests.
    """
    rests = find_rests(recording)
    if len(rests.means) < FEWEST_POSES:
        raise SensorError(
            f"{len(rests.means)} rests were found, but {FEWEST_POSES} are needed: "
            f"{detect_rests(recording).reason} Lay the sensor down in each pose for some seconds."
        )
    return rests
