"""The disparity of the next frame while this one is looked at."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from queue import Empty, Full, Queue
from threading import Event, Semaphore, Thread
from typing import TypeVar, cast

from polemap.drivelog.samples import StereoFrame
from polemap.stereo.matching import DisparityPair

_Sample = TypeVar("_Sample")
_FRAMES_AHEAD, _SAMPLES_AHEAD = 1, 256
_LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class MatchedFrame(StereoFrame):
    """A stereo frame with its disparity maps."""

    disparity: DisparityPair


def match_ahead(
    samples: Iterable[_Sample], match: Callable[[StereoFrame], MatchedFrame]
) -> Iterator[_Sample]:
    """The samples in their order, frames with their disparity.

    A thread reads and matches one frame ahead; the matcher's compiled loops leave Python free for
    whoever looks at the frame before. The result is that of matching one after the other.

    Raises:
        Exception: what reading or matching raised, at the sample's turn.
    """
    coming: Queue[_Sample | BaseException | None] = Queue(_SAMPLES_AHEAD)
    room, stop = Semaphore(1 + _FRAMES_AHEAD), Event()

    def hand_over(sample: _Sample | BaseException | None) -> None:
        while not stop.is_set():
            try:
                coming.put(sample, timeout=_LOOK_S)
            except Full:
                continue
            return

    def read() -> None:
        try:
            for sample in samples:
                if isinstance(sample, StereoFrame):
                    while not room.acquire(timeout=_LOOK_S):
                        if stop.is_set():
                            return
                    hand_over(cast(_Sample, match(sample)))
                else:
                    hand_over(sample)
                if stop.is_set():
                    return
            hand_over(None)
        except BaseException as error:  # handed to the thread that asks
            hand_over(error)

    thread = Thread(target=read, name="matching", daemon=True)
    thread.start()
    try:
        while (sample := _next(coming)) is not None:
            if isinstance(sample, BaseException):
                raise sample
            yield sample
            if isinstance(sample, StereoFrame):
                room.release()
    finally:
        # a thread inside compiled code when the process ends aborts it
        stop.set()
        thread.join()


def _next(coming: Queue[_Sample]) -> _Sample:
    """Waits so that Ctrl-C is heard."""
    while True:
        try:
            return coming.get(timeout=_LOOK_S)
        except Empty:
            continue
