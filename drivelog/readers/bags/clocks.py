"""Times of the messages of a topic: measured by their header, arrived by the log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.readers.bags.index import Topic

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SECOND_NS = 1_000_000_000
# no message is a minute on its way: the recorder's clock is another one, or it is a replay
_ANOTHER_CLOCK_NS = 60 * _SECOND_NS
# by how much the way of messages may vary before the two clocks do not even run alike
_STEADY_NS = 2 * _SECOND_NS
# log times that went through a float of seconds since 1970 are off by less
_ROUNDING_NS = 1_000


@dataclass(frozen=True, slots=True)
class Times:
    """`(n,)` nanoseconds since 1970, or since the start of a simulation."""

    stamp_ns: Integers
    arrival_ns: Integers

    @property
    def stamp_s(self) -> Floats:
        """When it was measured."""
        return seconds(self.stamp_ns)

    @property
    def arrival_s(self) -> Floats:
        """When it reached the recorder."""
        return seconds(self.arrival_ns)


def seconds(nanoseconds: Integers) -> Floats:
    """The double nearest to each number of nanoseconds, as if its decimals had been read."""
    # exact below 2^53; above it the number itself would be rounded before it is divided
    whole, rest = np.divmod(nanoseconds, _SECOND_NS)
    exact = np.abs(nanoseconds) < 2**53
    return np.asarray(np.where(exact, nanoseconds / 1e9, whole + rest / 1e9), dtype=np.float64)


@dataclass(slots=True)
class LogClock:
    """How the clock of the log stands to that of the headers.

    Attributes:
        ahead_ns: what is subtracted from times of recording.
        usable: whether times of recording say anything of when a message arrived.
        note: what a reader of a result must know.
    """

    ahead_ns: int = 0
    usable: bool = True
    note: str | None = None


def compare_clocks(topics: Sequence[Topic]) -> LogClock:
    """The log's clock against the headers of the topics that are used."""
    ways = []
    for topic in topics:
        stamped = topic.stamps_ns > 0
        if np.any(stamped):
            ways.append(topic.logs_ns[stamped] - topic.stamps_ns[stamped])
    if not ways:
        return LogClock()
    middles = [int(np.median(way)) for way in ways]
    if abs(np.median(middles)) < _ANOTHER_CLOCK_NS:
        return LogClock()
    spread = max(float(np.ptp(np.percentile(way, [5, 95]))) for way in ways)
    apart = float(np.median(middles)) * 1e-9
    if spread > _STEADY_NS or np.ptp(middles) > _STEADY_NS:
        return LogClock(
            usable=False,
            note=f"the log was written {apart:.0f} s apart from the headers' clock and at another "
            "pace: arrivals are not known, the stamps are taken for them",
        )
    ahead = min(int(np.percentile(way, 1)) for way in ways)
    return LogClock(
        ahead_ns=ahead,
        note=f"the log's clock is {apart:.0f} s apart from that of the headers: arrivals are "
        "counted from the quickest messages",
    )


def times_of(
    topic: Topic, clock: LogClock, name: str, problems: Counter[str], notes: list[str]
) -> Times:
    """Times of a topic's messages, in the order of recording.

    A stamp of zero becomes the time of recording, with a note.
    """
    arrival = topic.logs_ns - clock.ahead_ns
    stamp = topic.stamps_ns
    blank = stamp <= 0
    if _starts_at_zero(stamp):
        blank = np.zeros(len(stamp), dtype=bool)
    if np.any(blank):
        moved = int(np.count_nonzero(blank & (arrival != stamp)))
        if moved:
            notes.append(
                f"{topic.name}: {moved} of {len(stamp)} messages have no stamp: the time of "
                "recording is taken"
            )
        stamp = np.where(blank, arrival, stamp)
    if not clock.usable:
        return Times(stamp, stamp)
    early = stamp - arrival > _ROUNDING_NS
    if np.any(early):
        problems[f"{name}_arrival_before_stamp"] += int(np.count_nonzero(early))
    return Times(stamp, np.maximum(stamp, arrival))


def _starts_at_zero(stamps_ns: Integers) -> bool:
    """Whether the one stamp of zero is that of the first message, of a clock that began there."""
    if len(stamps_ns) < 2 or stamps_ns[0] != 0 or np.count_nonzero(stamps_ns <= 0) != 1:
        return False
    return bool(stamps_ns[1] < _ANOTHER_CLOCK_NS)
