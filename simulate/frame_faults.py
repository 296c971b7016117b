"""Faults of the camera: pictures that are lost, repeated, swapped or spoilt.

Images are spoilt as they are read, so that a faulty drive costs no copy.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from polemap.drivelog.drive import Drive, FrameSource
from polemap.drivelog.samples import Image
from polemap.simulate.drive_fault import DriveFault, Share
from polemap.simulate.picture_faults import blur, brighten, dirt, each, turning, warp

Pair = tuple[Image, Image]
PairFault = Callable[[Pair, int], Pair]


@dataclass(frozen=True, slots=True)
class SpoiltFrames:
    """A frame source whose pairs pass through a fault; `rows` lead to the inner source."""

    inner: FrameSource
    rows: NDArray[np.int64]
    hit: NDArray[np.bool_]
    fault: PairFault

    def load(self, row: int) -> Pair:
        """The pair of a row, spoilt where the fault covers it."""
        pair = self.inner.load(int(self.rows[row]))
        return self.fault(pair, int(self.rows[row])) if self.hit[row] else pair

    def keep(self, rows: NDArray[np.int64]) -> FrameSource:
        """The same source with these rows only."""
        return SpoiltFrames(self.inner, self.rows[rows], self.hit[rows], self.fault)


class PictureFault(DriveFault):
    """A fault that spoils pictures as they are read."""

    @abstractmethod
    def spoiling(self, drive: Drive, rng: np.random.Generator) -> PairFault:
        """What happens to the pair of a row."""

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        if drive.images is None:
            return drive
        hit, rows = self.during(drive.frame_stamps_s), np.arange(len(drive.frame_stamps_s))
        spoilt = SpoiltFrames(drive.images, rows, hit, self.spoiling(drive, rng))
        return replace(drive, images=spoilt)


class DroppedFrames(DriveFault):
    """Pictures that never arrive."""

    kind: Literal["dropped_frames"] = "dropped_frames"
    share: Share = 1.0

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        lost = self.during(drive.frame_stamps_s) & (
            rng.uniform(size=len(drive.frame_stamps_s)) < self.share
        )
        kept = np.flatnonzero(~lost)
        return replace(
            drive,
            frame_stamps_s=drive.frame_stamps_s[kept],
            frame_arrivals_s=drive.frame_arrivals_s[kept],
            frame_numbers=drive.frame_numbers[kept],
            images=drive.images.keep(kept) if drive.images else None,
        )


class FrozenFrames(DriveFault):
    """The camera repeats its last picture, with new stamps."""

    kind: Literal["frozen_frames"] = "frozen_frames"

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        hit = self.during(drive.frame_stamps_s)
        if drive.images is None or not hit.any():
            return drive
        rows = np.arange(len(hit))
        rows[hit] = max(0, int(np.flatnonzero(hit)[0]) - 1)
        return replace(drive, images=drive.images.keep(rows))


class SwappedCameras(PictureFault):
    """Left is right and right is left."""

    kind: Literal["swapped_cameras"] = "swapped_cameras"

    def spoiling(self, drive: Drive, rng: np.random.Generator) -> PairFault:
        return lambda pair, _: (pair[1], pair[0])


class OverExposed(PictureFault):
    """Both pictures too bright by a factor; what is white stays white."""

    kind: Literal["over_exposed"] = "over_exposed"
    factor: Annotated[float, Field(gt=0)] = 4.0

    def spoiling(self, drive: Drive, rng: np.random.Generator) -> PairFault:
        return lambda pair, _: each(pair, lambda image: brighten(image, self.factor))


class BlurredFrames(PictureFault):
    """Pictures out of focus."""

    kind: Literal["blurred_frames"] = "blurred_frames"
    sigma_px: Annotated[float, Field(gt=0)] = 3.0

    def spoiling(self, drive: Drive, rng: np.random.Generator) -> PairFault:
        return lambda pair, _: each(pair, lambda image: blur(image, self.sigma_px))


class DirtyLens(PictureFault):
    """Drops and dirt on one lens, at the same place in every picture."""

    kind: Literal["dirty_lens"] = "dirty_lens"
    camera: Literal["left", "right"] = "left"
    spots: int = Field(default=12, ge=1, le=500)
    radius_px: Annotated[float, Field(gt=0)] = 22.0

    def spoiling(self, drive: Drive, rng: np.random.Generator) -> PairFault:
        seed = int(rng.integers(2**31))
        side = 0 if self.camera == "left" else 1

        def spoil(pair: Pair, _: int) -> Pair:
            dirty = dirt(pair[side], self.spots, self.radius_px, np.random.default_rng(seed))
            return (dirty, pair[1]) if side == 0 else (pair[0], dirty)

        return spoil


class Miscalibration(PictureFault):
    """The right camera has turned since it was calibrated; degrees about its own axes."""

    kind: Literal["miscalibration"] = "miscalibration"
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0

    def spoiling(self, drive: Drive, rng: np.random.Generator) -> PairFault:
        if drive.rig is None:
            return lambda pair, _: pair
        turned = turning(drive.rig, self.pitch_deg, self.yaw_deg, self.roll_deg)
        return lambda pair, _: (pair[0], warp(pair[1], turned))
