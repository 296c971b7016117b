"""Faults that can be laid over any drive, one after the other: what breaks in the field.

Every fault is a frozen model with `apply(drive, rng) -> Drive`; a list of them is a setting
(`simulate.faults`) as well as a tool for tests. Images are spoilt as they are read, so that a
faulty drive costs no copy; `drivelog.writers.folder.write_drive` writes one down.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from drivelog.drive import Drive, FrameSource
from drivelog.samples import Image
from drivelog.streams import GnssStream, OdometryStream
from polemap.landmark_map import PoleMap
from simulate import picture_faults
from simulate.map_faults import MapFault, PolesAdded, PolesRemoved

Floats = NDArray[np.float64]
Share = Annotated[float, Field(ge=0, le=1)]
Pair = tuple[Image, Image]
PairFault = Callable[[Pair, int], Pair]


class _Fault(BaseModel):
    """A fault between `from_s` and `until_s` of the drive's stamps."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    from_s: float = float("-inf")
    until_s: float = float("inf")

    def during(self, stamps_s: Floats) -> NDArray[np.bool_]:
        """Which stamps the fault covers."""
        return np.asarray((stamps_s >= self.from_s) & (stamps_s < self.until_s))

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        """The drive with this fault in it; the plain interval changes nothing."""
        return drive


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


def _spoil(drive: Drive, hit: NDArray[np.bool_], fault: PairFault) -> Drive:
    if drive.images is None:
        return drive
    rows = np.arange(len(drive.frame_stamps_s))
    return replace(drive, images=SpoiltFrames(drive.images, rows, hit, fault))


class DroppedFrames(_Fault):
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


class FrozenFrames(_Fault):
    """The camera repeats its last picture, with new stamps."""

    kind: Literal["frozen_frames"] = "frozen_frames"

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        hit = self.during(drive.frame_stamps_s)
        if drive.images is None or not hit.any():
            return drive
        rows = np.arange(len(hit))
        rows[hit] = max(0, int(np.flatnonzero(hit)[0]) - 1)
        return replace(drive, images=drive.images.keep(rows))


class SwappedCameras(_Fault):
    """Left is right and right is left."""

    kind: Literal["swapped_cameras"] = "swapped_cameras"

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        return _spoil(drive, self.during(drive.frame_stamps_s), lambda pair, _: (pair[1], pair[0]))


class OverExposed(_Fault):
    """Both pictures too bright by a factor; what is white stays white."""

    kind: Literal["over_exposed"] = "over_exposed"
    factor: Annotated[float, Field(gt=0)] = 4.0

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        factor = self.factor
        return _spoil(
            drive,
            self.during(drive.frame_stamps_s),
            lambda pair, _: picture_faults.each(pair, lambda i: picture_faults.brighten(i, factor)),
        )


class BlurredFrames(_Fault):
    """Pictures out of focus."""

    kind: Literal["blurred_frames"] = "blurred_frames"
    sigma_px: Annotated[float, Field(gt=0)] = 3.0

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        sigma = self.sigma_px
        return _spoil(
            drive,
            self.during(drive.frame_stamps_s),
            lambda pair, _: picture_faults.each(pair, lambda i: picture_faults.blur(i, sigma)),
        )


class DirtyLens(_Fault):
    """Drops and dirt on one lens, at the same place in every picture."""

    kind: Literal["dirty_lens"] = "dirty_lens"
    camera: Literal["left", "right"] = "left"
    spots: int = Field(default=12, ge=1, le=500)
    radius_px: Annotated[float, Field(gt=0)] = 22.0

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        seed = int(rng.integers(2**31))
        side = 0 if self.camera == "left" else 1

        def spoil(pair: Pair, _: int) -> Pair:
            dirty = picture_faults.dirt(
                pair[side], self.spots, self.radius_px, np.random.default_rng(seed)
            )
            return (dirty, pair[1]) if side == 0 else (pair[0], dirty)

        return _spoil(drive, self.during(drive.frame_stamps_s), spoil)


class Miscalibration(_Fault):
    """The right camera has turned since it was calibrated; degrees about its own axes."""

    kind: Literal["miscalibration"] = "miscalibration"
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        rig = drive.rig
        if rig is None:
            return drive
        warp = picture_faults.turning(rig, self.pitch_deg, self.yaw_deg, self.roll_deg)
        return _spoil(
            drive,
            self.during(drive.frame_stamps_s),
            lambda pair, _: (pair[0], picture_faults.warp(pair[1], warp)),
        )


class NotANumber(_Fault):
    """Values that are not numbers in a stream."""

    kind: Literal["not_a_number"] = "not_a_number"
    stream: Literal["odometry", "gnss"] = "odometry"
    share: Share = 0.05

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        if self.stream == "odometry" and drive.odometry is not None:
            odometry = drive.odometry
            hit = self.during(odometry.stamp_s) & (rng.uniform(size=len(odometry)) < self.share)
            return replace(
                drive,
                odometry=replace(
                    odometry,
                    speed_mps=np.where(hit, np.nan, odometry.speed_mps),
                    yaw_rate_radps=np.where(hit, np.nan, odometry.yaw_rate_radps),
                ),
            )
        if self.stream == "gnss" and drive.gnss is not None:
            gnss = drive.gnss
            hit = self.during(gnss.stamp_s) & (rng.uniform(size=len(gnss)) < self.share)
            return replace(drive, gnss=replace(gnss, east_m=np.where(hit, np.nan, gnss.east_m)))
        return drive


class ClockJump(_Fault):
    """A sensor's clock jumps by `by_s` at `from_s` (and back at `until_s`)."""

    kind: Literal["clock_jump"] = "clock_jump"
    stream: Literal["frames", "odometry", "gnss"] = "odometry"
    by_s: float = 1.0

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        if self.stream == "frames":
            stamps = drive.frame_stamps_s
            return replace(drive, frame_stamps_s=stamps + self.by_s * self.during(stamps))
        stream: OdometryStream | GnssStream | None = getattr(drive, self.stream)
        if stream is None:
            return drive
        moved = stream.stamp_s + self.by_s * self.during(stream.stamp_s)
        if isinstance(stream, OdometryStream):
            return replace(drive, odometry=replace(stream, stamp_s=moved))
        return replace(drive, gnss=replace(stream, stamp_s=moved))


class OdometryDropout(_Fault):
    """No odometry for a while."""

    kind: Literal["odometry_dropout"] = "odometry_dropout"

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        if drive.odometry is None:
            return drive
        return replace(drive, odometry=drive.odometry.rows(~self.during(drive.odometry.stamp_s)))


class GnssDropout(_Fault):
    """No fixes for a while."""

    kind: Literal["gnss_dropout"] = "gnss_dropout"

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        if drive.gnss is None:
            return drive
        return replace(drive, gnss=drive.gnss.rows(~self.during(drive.gnss.stamp_s)))


class GnssOffset(_Fault):
    """All fixes shifted, with no word of it in the dilution of precision."""

    kind: Literal["gnss_offset"] = "gnss_offset"
    east_m: float = 10.0
    north_m: float = 0.0

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        if drive.gnss is None:
            return drive
        hit = self.during(drive.gnss.stamp_s)
        return replace(
            drive,
            gnss=replace(
                drive.gnss,
                east_m=drive.gnss.east_m + self.east_m * hit,
                north_m=drive.gnss.north_m + self.north_m * hit,
            ),
        )


Fault = Annotated[
    DroppedFrames | FrozenFrames | SwappedCameras | OverExposed | BlurredFrames | DirtyLens
    | Miscalibration | NotANumber | ClockJump | OdometryDropout | GnssDropout | GnssOffset
    | PolesAdded | PolesRemoved,
    Field(discriminator="kind"),
]  # fmt: skip


def apply_faults(drive: Drive, faults: Sequence[_Fault | MapFault], seed: int) -> Drive:
    """The drive with all faults, in the order given; each draws from its own stream of the seed."""
    for index, fault in enumerate(faults):
        if isinstance(fault, _Fault):
            drive = fault.apply(drive, _draws(seed, index))
    return drive


def age_map(pole_map: PoleMap, faults: Sequence[_Fault | MapFault], seed: int) -> PoleMap:
    """The map with what the faults say of poles put up or taken away since it was made."""
    for index, fault in enumerate(faults):
        if isinstance(fault, MapFault):
            pole_map = fault.age(pole_map, _draws(seed, index))
    return pole_map


def _draws(seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng([seed, 9000, index])
