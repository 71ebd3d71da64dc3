"""The real recordings as channels: each file by its field's own library, each rate a part of its own.

Needs `pip install 'becalm[formats]'`. Nothing is resampled and nothing is left out: constant channels, counters,
flags and clocks that a logger wrote are parts of what it wrote.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import becalm

DATA = Path(__file__).parents[2] / "shared" / "data"

COUNTED_HZ = {"imu_sample.csv": 204.8, "mocap_sample.csv": 100.0}
"""Rates of the tables that only count their rows."""

BROAD_UNITS = {"imu_acc": "m/s^2", "imu_gyr": "rad/s", "imu_mag": "uT", "opt_pos": "m"}


class Part(NamedTuple):
    """Channels that share one time base, before anything is asked of them.

    Attributes
    ----------
    title : str
        Which of the file's rates it is; "" where there is only one.
    channels : mapping of str to (N,) float array
        Readings by name, NaN where missing.
    units : tuple of str
        One a channel, "" where the file tells none.
    time : becalm.core.timebase.Timebase's argument
        Rate in Hz, or (N,) stamps in seconds.
    """

    title: str
    channels: Mapping[str, NDArray[np.float64]]
    units: tuple[str, ...]
    time: float | NDArray[np.float64]

    def recording(self) -> becalm.Recording:
        """Make the recording; raises becalm's errors where the times cannot serve."""
        samples = np.column_stack(list(self.channels.values()))
        if isinstance(self.time, float):
            return becalm.Recording(samples, names=list(self.channels), units=self.units, rate_hz=self.time)
        return becalm.Recording(samples, names=list(self.channels), units=self.units, times_s=self.time)


def files() -> list[Path]:
    """List the recordings."""
    return sorted(path for path in DATA.glob("*/*") if _reader(path))


def parts(path: Path) -> Iterator[Part]:
    """Read one file, a part for each of its rates."""
    reader = _reader(path)
    if reader is None:
        raise ValueError(f"{path.name} is of no known kind; one of {', '.join(READERS)} is needed.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # a library leaves its file to the collector
        yield from reader(path)


def _reader(path: Path) -> Callable[[Path], Iterator[Part]] | None:
    return next((reader for ending, reader in READERS.items() if path.name.lower().endswith(ending)), None)


def _column(values: ArrayLike) -> NDArray[np.float64]:
    """Take flags and counters as numbers."""
    return np.asarray(values).astype(np.float64)


def _axes(name: str, table: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Name the columns of a table; one of a single column keeps its name."""
    if table.ndim == 1 or table.shape[1] == 1:
        return {name: _column(table).reshape(-1)}
    return {f"{name}_{axis}": _column(column) for axis, column in enumerate(table.T)}


def _csv(path: Path) -> Iterator[Part]:
    """Read with becalm itself."""
    read = becalm.read(path, rate_hz=COUNTED_HZ.get(path.name))
    yield Part("", {name: read.channel(name) for name in read.names}, read.units, read.times_s)


def _broad(tables: Mapping[str, NDArray[np.float64]], rate_hz: float) -> Iterator[Part]:
    channels, units = {}, []
    for name in ("imu_acc", "imu_gyr", "imu_mag", "opt_pos", "opt_quat", "movement"):
        axes = _axes(name, tables[name])
        channels |= axes
        units += [BROAD_UNITS.get(name, "")] * len(axes)
    yield Part("", channels, tuple(units), rate_hz)


def _hdf5(path: Path) -> Iterator[Part]:
    import h5py

    with h5py.File(path) as opened:
        yield from _broad({name: opened[name][:] for name in opened}, float(opened.attrs["sampling_rate"]))


def _mat(path: Path) -> Iterator[Part]:
    from scipy.io import loadmat

    held = loadmat(path)
    yield from _broad(held, float(held["sampling_rate"].item()))


def _columns_of_text(path: Path) -> Iterator[Part]:
    """Read time and three axes."""
    table = np.loadtxt(path)
    yield Part("", _axes(path.name.split(".")[0], table[:, 1:]), ("",) * 3, table[:, 0])


def _uff(path: Path) -> Iterator[Part]:
    """Read UFF58; sets of equal length and step are one part."""
    from pyuff import UFF

    def even(one: Mapping[str, object]) -> tuple[object, ...]:
        return one["num_pts"], one["abscissa_inc"], one["abscissa_spacing"]

    for (_, step_s, spacing), group in groupby(UFF(str(path)).read_sets(), even):
        sets = list(group)
        channels = {one["id1"]: _column(one["data"]) for one in sets}
        units = tuple(one["ordinate_axis_units_lab"] for one in sets)
        yield Part("", channels, units, 1.0 / float(step_s) if spacing else _column(sets[0]["x"]))


def _ide(path: Path) -> Iterator[Part]:
    """Read a shock recorder's channels, calibrated; times are its own, in microseconds."""
    import idelib

    opened = idelib.importFile(str(path))
    for channel in opened.channels.values():
        times_us, *columns = channel.getSession().arraySlice()
        names = [sub.displayName for sub in channel.subchannels]
        units = tuple(sub.units[1] or "" for sub in channel.subchannels)
        title = f"{channel.name} (channel {channel.id})"
        yield Part(title, dict(zip(names, map(_column, columns), strict=True)), units, times_us * 1e-6)
    opened.close()


def _ulog(path: Path) -> Iterator[Part]:
    """Read a drone's messages; each topic has its own rate, times are in microseconds."""
    from pyulog import ULog

    for topic in ULog(str(path)).data_list:
        channels = {name: _column(values) for name, values in topic.data.items() if name != "timestamp"}
        title = f"{topic.name} {topic.multi_id}"
        yield Part(title, channels, ("",) * len(channels), _column(topic.data["timestamp"]) * 1e-6)


def _mf4(path: Path) -> Iterator[Part]:
    """Decode a CAN log by the database beside it; states that have a text are taken by their number."""
    from asammdf import MDF

    databases = [(str(database), 0) for database in sorted(path.parent.glob("*.dbc"))]
    with MDF(path) as log, log.extract_bus_logging(database_files={"CAN": databases}) as decoded:
        for index, group in enumerate(decoded.groups):
            signals = [_numbers(decoded, index, channel.name) for channel in group.channels[1:]]
            channels = {signal.name: _column(signal.samples) for signal in signals}
            title = group.channel_group.acq_name or f"group {index}"
            yield Part(title, channels, tuple(signal.unit for signal in signals), signals[0].timestamps)


def _numbers(decoded: object, group: int, name: str) -> object:
    signal = decoded.get(name, group=group)
    return signal if signal.samples.dtype.kind in "biuf" else decoded.get(name, group=group, raw=True)


READERS: dict[str, Callable[[Path], Iterator[Part]]] = {
    ".csv": _csv,
    ".csv.gz": _csv,
    ".hdf5": _hdf5,
    ".mat": _mat,
    ".mat.txt.gz": _columns_of_text,
    ".mf4": _mf4,
    ".ide": _ide,
    ".ulg": _ulog,
    ".uff": _uff,
}
