"""A stereo pair that has arrived and is decoded only if there is time to look at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from polemap.drivelog.samples import Image, StereoFrame


@dataclass(frozen=True, slots=True)
class PendingFrame:
    """`load` decodes the pictures; the rest is what `StereoFrame` says of them."""

    stamp_s: float
    arrival_s: float
    index: int
    load: Callable[[], tuple[Image, Image]]

    def decoded(self) -> StereoFrame:
        """The pair.

        Raises:
            InputError: a picture that is damaged or missing.
        """
        left, right = self.load()
        return StereoFrame(self.stamp_s, self.arrival_s, self.index, left, right)
