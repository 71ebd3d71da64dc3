"""Split large chunks of a TDMS file, because npTDMS reads a channel's whole chunk for every block of rows."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import Any

_PIECE_BYTES = 1 << 22  # size of a piece of one channel, or of interleaved rows
_INTERLEAVED = 1 << 5


def in_pieces(held: Any) -> None:
    """Replace the large chunks of an open file by small segments, which npTDMS reads one by one; uses its internals."""
    reader = getattr(held, "_reader", None)
    if reader is not None:
        reader._segments = [piece for segment in reader._segments for piece in _pieces(segment)]


def _pieces(segment: Any) -> Iterator[Any]:
    objects = [one for one in segment.ordered_objects if one.has_data]
    sized = [one for one in objects if one.data_type is not None and one.data_type.size]
    rows = max((one.number_values for one in sized), default=0)
    interleaved = bool(segment.toc_mask & _INTERLEAVED)
    widths = [one.data_type.size for one in sized]
    width = (sum if interleaved else max)(widths or [1])
    if segment._have_daqmx_objects() or rows * width <= _PIECE_BYTES or (interleaved and len(sized) < len(objects)):
        yield segment
        return
    for chunk in range(segment.num_chunks):
        counts = _counts(segment, objects, chunk)
        start = segment.data_position + chunk * segment._get_chunk_size()
        for first in range(0, max(counts.values()), max(1, _PIECE_BYTES // width)):
            yield _piece(segment, counts, start, (first, first + max(1, _PIECE_BYTES // width)), interleaved)


def _counts(segment: Any, objects: list[Any], chunk: int) -> dict[str, int]:
    """Return the number of values of each channel in a chunk; the last chunk may be truncated."""
    cut = segment.final_chunk_lengths_override if chunk == segment.num_chunks - 1 else None
    return {one.path: one.number_values if cut is None else cut.get(one.path, 0) for one in objects}


def _piece(segment: Any, counts: dict[str, int], start: int, rows: tuple[int, int], interleaved: bool) -> Any:
    """Return a segment with some rows of a chunk; `data_size` of a channel is the distance to the next one's rows."""
    made, objects, places, at = copy(segment), [], [], start
    for one in segment.ordered_objects:
        part = copy(one)
        objects.append(part)
        if not one.has_data:
            continue
        count, size = counts[one.path], one.data_type.size
        first, last = (min(row, count) for row in rows) if size else (0, count if not rows[0] else 0)
        part.number_values = last - first
        places.append((part, at + first * (size or 0)))
        at += count * size if size else one.data_size
    stops = [place for _, place in places[1:]] + [at]
    for (part, place), stop in zip(places, stops, strict=True):
        part.data_size = stop - place
    width = sum(part.data_type.size for part, _ in places) if interleaved else 0
    made.ordered_objects, made.data_objects_cached, made.chunk_size_cached = objects, None, None
    made.data_position = start + rows[0] * width if interleaved else places[0][1]
    made.num_chunks, made.final_chunk_lengths_override = 1, None
    return made
