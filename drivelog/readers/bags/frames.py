"""Stereo pairs of a recording: which pictures belong together, and reading them when needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags.clocks import times_of
from polemap.drivelog.readers.bags.container import Channel, Container
from polemap.drivelog.readers.bags.decoding import decoder_of
from polemap.drivelog.readers.bags.index import LogIndex, Topic
from polemap.drivelog.readers.bags.pictures import grey
from polemap.drivelog.readers.bags.signals import Signals
from polemap.drivelog.samples import Image
from polemap.errors import PolemapError
from polemap.parsing.errors import named

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

PAIR_TOLERANCE_NS = 5_000_000


@dataclass(frozen=True, slots=True)
class LogPictures:
    """Pictures of a pair of topics, read from the recording one by one.

    Attributes:
        containers: files of the recording.
        channels: of left and right.
        places: `(n, 2, 4)` file, block, offset and size of the pictures of each pair.
        rows: `(n, 2)` number of each picture in its topic, for errors.
        size_px: width and height that each must have.
    """

    containers: tuple[Container, ...]
    channels: tuple[Channel, Channel]
    places: Integers
    rows: Integers
    size_px: tuple[int, int]

    def load(self, row: int) -> tuple[Image, Image]:
        """Left and right picture of a row.

        Raises:
            InputError: one cannot be read or decoded, is of another size or of another depth.
        """
        left, right = self._one(row, 0), self._one(row, 1)
        if left.dtype != right.dtype:
            raise InputError(
                f"{self._place(row, 1)}: {right.dtype} pixels, but the left picture has "
                f"{left.dtype}"
            )
        return left, right

    def _one(self, row: int, side: int) -> Image:
        place = self._place(row, side)
        file, block, offset, size = (int(value) for value in self.places[row, side])
        with named(place, InputError, "picture"):
            data = self.containers[file].read(block, offset, size)
            picture = grey(decode_picture(self.channels[side], data, place), place)
        height, width = picture.shape
        if (width, height) != self.size_px:
            raise InputError(
                f"{place}: {width}x{height} pixels, its calibration is of "
                f"{self.size_px[0]}x{self.size_px[1]}"
            )
        return picture

    def _place(self, row: int, side: int) -> str:
        return f"{self.channels[side].topic}, picture {int(self.rows[row, side])}"

    def keep(self, rows: NDArray[np.int64]) -> LogPictures:
        """The same source with these rows only."""
        return LogPictures(
            self.containers, self.channels, self.places[rows], self.rows[rows], self.size_px
        )


def decode_picture(channel: Channel, data: bytes, place: str) -> object:
    """The message of a picture.

    Raises:
        InputError: it is damaged.
    """
    try:
        return decoder_of(channel)(data)
    except PolemapError:
        raise
    except Exception as error:  # generated code raises what it raises
        raise InputError(f"{place}: damaged message ({type(error).__name__}: {error})") from error


@dataclass(frozen=True, slots=True)
class Pairs:
    """Rows `(n, 2)` of left and right that belong together, and when they were taken."""

    rows: Integers
    stamp_ns: Integers
    arrival_ns: Integers


def pair_pictures(
    left: Topic, right: Topic, tolerance_s: float | None, signals: Signals
) -> tuple[Pairs, float]:
    """Every left picture with the right one of nearest stamp; what finds none is counted.

    Returns:
        The pairs, and the tolerance in seconds that was applied.
    """
    problems = signals.problems
    times = [
        times_of(topic, signals.clock, name, problems, signals.notes)
        for topic, name in ((left, "left"), (right, "right"))
    ]
    orders = [np.argsort(one.stamp_ns, kind="stable") for one in times]
    ours, theirs = (one.stamp_ns[order] for one, order in zip(times, orders, strict=True))
    tolerance = PAIR_TOLERANCE_NS
    if tolerance_s is not None:
        tolerance = round(tolerance_s * 1e9)
    elif len(ours) > 1:
        steps = np.diff(ours)
        steps = steps[steps > 0]  # pictures that were recorded twice
        tolerance = min(tolerance, int(np.median(steps) // 2)) if len(steps) else tolerance
    matched = nearest_once(ours, theirs, tolerance)
    kept = np.flatnonzero(matched >= 0)
    for name, lost in (("left", len(ours) - len(kept)), ("right", len(theirs) - len(kept))):
        if lost:
            problems[f"{name}_pictures_without_partner"] += lost
    rows = np.stack([orders[0][kept], orders[1][matched[kept]]], axis=1).astype(np.int64)
    stamp = ours[kept]
    again = np.concatenate([[False], np.diff(stamp) == 0]) if len(stamp) else np.zeros(0, bool)
    if np.any(again):
        problems["frames_duplicate_stamps"] += int(np.count_nonzero(again))
        rows, stamp = rows[~again], stamp[~again]
    arrival = np.maximum(times[0].arrival_ns[rows[:, 0]], times[1].arrival_ns[rows[:, 1]])
    return Pairs(rows, stamp, np.maximum(arrival, stamp)), tolerance * 1e-9


def nearest_once(ours: Integers, theirs: Integers, tolerance: int) -> Integers:
    """For each of our sorted stamps the row of the nearest of theirs, -1 beyond the tolerance.

    Where two of ours are nearest to the same one, the nearer has it.
    """
    if not len(theirs):
        return np.full(len(ours), -1, dtype=np.int64)
    after = np.clip(np.searchsorted(theirs, ours), 0, len(theirs) - 1)
    before = np.clip(after - 1, 0, len(theirs) - 1)
    closer = np.abs(theirs[before] - ours) <= np.abs(theirs[after] - ours)
    row = np.where(closer, before, after)
    apart = np.abs(theirs[row] - ours)
    order = np.lexsort((np.arange(len(ours)), apart, row))
    first = np.concatenate([[True], np.diff(row[order]) > 0]) if len(order) else order.astype(bool)
    matched = np.full(len(ours), -1, dtype=np.int64)
    chosen = order[first]
    chosen = chosen[apart[chosen] <= tolerance]
    matched[chosen] = row[chosen]
    return matched


def log_pictures(
    index: LogIndex, left: Topic, right: Topic, pairs: Pairs, size_px: tuple[int, int]
) -> LogPictures:
    """The pictures of the pairs."""
    places = np.stack([left.places[pairs.rows[:, 0]], right.places[pairs.rows[:, 1]]], axis=1)
    return LogPictures(index.containers, (left.channel, right.channel), places, pairs.rows, size_px)
