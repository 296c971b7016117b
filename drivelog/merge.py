"""Several streams of samples as one, in the order in which they became known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Read = TypeVar("Read", covariant=True)


@dataclass(frozen=True, slots=True)
class SampleRows(Generic[Read]):
    """One stream: when each row `(n,)` arrived and was measured, and how to read it."""

    arrival_s: Floats
    stamp_s: Floats
    read: Callable[[int], Read]


def merge_streams(streams: Sequence[SampleRows[Read]]) -> Iterator[Read]:
    """Every row of all streams by arrival; rows are read as they come up.

    Rows that arrive together come in the order of their stamps, and then in that of the streams: a
    filter that is to know the motion up to an image puts the odometry first.
    """
    if not streams:
        return
    arrival = np.concatenate([stream.arrival_s for stream in streams])
    stamp = np.concatenate([stream.stamp_s for stream in streams])
    lengths = [len(stream.stamp_s) for stream in streams]
    kind = np.repeat(np.arange(len(streams)), lengths)
    row = np.concatenate([np.arange(length) for length in lengths])
    for index in np.lexsort((kind, stamp, arrival)):
        yield streams[kind[index]].read(int(row[index]))
