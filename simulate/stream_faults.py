"""Faults of odometry and GNSS, and clocks that jump."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from polemap.drivelog.drive import Drive
from polemap.drivelog.streams import GnssStream, OdometryStream
from polemap.simulate.drive_fault import DriveFault, Share


class NotANumber(DriveFault):
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


class ClockJump(DriveFault):
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


class OdometryDropout(DriveFault):
    """No odometry for a while."""

    kind: Literal["odometry_dropout"] = "odometry_dropout"

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        if drive.odometry is None:
            return drive
        return replace(drive, odometry=drive.odometry.take(~self.during(drive.odometry.stamp_s)))


class GnssDropout(DriveFault):
    """No fixes for a while."""

    kind: Literal["gnss_dropout"] = "gnss_dropout"

    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        if drive.gnss is None:
            return drive
        return replace(drive, gnss=drive.gnss.take(~self.during(drive.gnss.stamp_s)))


class GnssOffset(DriveFault):
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
