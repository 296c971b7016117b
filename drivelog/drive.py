"""A drive: its streams, and one merged iterator over them in the order of arrival."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivelog.errors import InputError
from drivelog.frames import EarthFrame
from drivelog.samples import (
    GnssFix,
    Image,
    OdometrySample,
    PoleScan,
    ReferencePose,
    Sample,
    StereoFrame,
)
from stereo.rig import StereoRig
from vehicle.pose import Pose2D, wrap_angle

Floats = NDArray[np.float64]
Rows = slice | NDArray[np.bool_] | NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class OdometryStream:
    """Wheel odometry; every array `(n,)`, sorted by `stamp_s`."""

    stamp_s: Floats
    arrival_s: Floats
    speed_mps: Floats
    yaw_rate_radps: Floats

    def __len__(self) -> int:
        return len(self.stamp_s)

    def sample(self, row: int) -> OdometrySample:
        return OdometrySample(
            float(self.stamp_s[row]),
            float(self.arrival_s[row]),
            float(self.speed_mps[row]),
            float(self.yaw_rate_radps[row]),
        )

    def rows(self, rows: Rows) -> OdometryStream:
        return OdometryStream(
            self.stamp_s[rows],
            self.arrival_s[rows],
            self.speed_mps[rows],
            self.yaw_rate_radps[rows],
        )


@dataclass(frozen=True, slots=True)
class GnssStream:
    """GNSS fixes of the antenna in the drive's frame; every array `(n,)`, sorted by `stamp_s`."""

    stamp_s: Floats
    arrival_s: Floats
    east_m: Floats
    north_m: Floats
    hdop: Floats

    def __len__(self) -> int:
        return len(self.stamp_s)

    def sample(self, row: int) -> GnssFix:
        return GnssFix(
            float(self.stamp_s[row]),
            float(self.arrival_s[row]),
            float(self.east_m[row]),
            float(self.north_m[row]),
            float(self.hdop[row]),
        )

    def rows(self, rows: Rows) -> GnssStream:
        return GnssStream(
            self.stamp_s[rows],
            self.arrival_s[rows],
            self.east_m[rows],
            self.north_m[rows],
            self.hdop[rows],
        )


@dataclass(frozen=True, slots=True)
class ReferenceStream:
    """Rear-axle poses `(n, 3)` east, north, yaw of a reference system, sorted by `stamp_s`.

    `sd_m` `(n,)` is its own standard deviation per axis, NaN where it does not say.
    """

    stamp_s: Floats
    poses: Floats
    sd_m: Floats

    def __len__(self) -> int:
        return len(self.stamp_s)

    def at(self, stamps_s: Any, *, max_gap_s: float = 1.0) -> Floats:
        """Poses `(m, 3)` at the stamps `(m,)`, linear between neighbours (yaw along the short way).

        NaN before the first and after the last pose and inside gaps longer than `max_gap_s`.
        """
        stamps = np.atleast_1d(np.asarray(stamps_s, dtype=np.float64))
        result = np.full((len(stamps), 3), np.nan)
        if not len(self):
            return result
        inside, low, high, share = self._bracket(stamps, max_gap_s)
        start, end = self.poses[low], self.poses[high]
        step = end - start
        step[:, 2] = wrap_angle(step[:, 2])
        poses = start + share[:, None] * step
        poses[:, 2] = wrap_angle(poses[:, 2])
        result[inside] = poses
        return result

    def sd_at(self, stamps_s: Any) -> Floats:
        """Standard deviations `(m,)` at the stamps `(m,)`, of the nearest pose before."""
        stamps = np.atleast_1d(np.asarray(stamps_s, dtype=np.float64))
        if not len(self):
            return np.full(len(stamps), np.nan)
        low = np.clip(np.searchsorted(self.stamp_s, stamps, side="right") - 1, 0, len(self) - 1)
        return np.asarray(self.sd_m[low])

    def _bracket(
        self, stamps: Floats, max_gap_s: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64], Floats]:
        low = np.searchsorted(self.stamp_s, stamps, side="right") - 1
        within = (low >= 0) & (stamps <= self.stamp_s[-1])
        low = np.clip(low, 0, len(self) - 1)
        high = np.minimum(low + 1, len(self) - 1)
        gap = self.stamp_s[high] - self.stamp_s[low]
        exact = stamps == self.stamp_s[low]
        inside = within & (exact | (gap <= max_gap_s))
        low, high, gap = low[inside], high[inside], gap[inside]
        share = np.where(
            gap > 0, (stamps[inside] - self.stamp_s[low]) / np.where(gap > 0, gap, 1), 0
        )
        return inside, low, high, share

    def sample(self, row: int) -> ReferencePose:
        east, north, yaw = (float(value) for value in self.poses[row])
        return ReferencePose(
            float(self.stamp_s[row]), Pose2D(east, north, yaw), float(self.sd_m[row])
        )

    def rows(self, rows: Rows) -> ReferenceStream:
        return ReferenceStream(self.stamp_s[rows], self.poses[rows], self.sd_m[rows])


@dataclass(frozen=True, slots=True)
class Lap:
    """A named part of a drive, from `start_s` up to but without `end_s`."""

    name: str
    start_s: float
    end_s: float


class FrameSource(Protocol):
    """Where the images of a drive come from; row i belongs to `Drive.frame_stamps_s[i]`."""

    def load(self, row: int) -> tuple[Image, Image]:
        """The rectified grey pair of a row.

        Raises:
            InputError: an image that is missing, damaged or of another size than the camera.
        """
        ...

    def keep(self, rows: NDArray[np.int64]) -> FrameSource:
        """The same source with these rows only."""
        ...


def _empty() -> Floats:
    return np.empty(0)


@dataclass(frozen=True, slots=True)
class Drive:
    """One recording, whatever it was stored as.

    Attributes:
        frame: earth frame of GNSS and reference.
        wheelbase_m: rear axle to front axle.
        rig: stereo camera, None where the drive has no images.
        gnss_antenna_m: `(2,)` antenna in the vehicle frame.
        frame_stamps_s, frame_arrivals_s: `(n,)` of the stereo pairs, sorted by stamp.
        frame_numbers: `(n,)` number of each pair in the recording (gaps are real).
        odometry, gnss, reference: None where the drive lacks the sensor.
        scans: poles that were detected elsewhere, sorted by stamp.
        laps: named parts.
        notes: what a reader of a result must know about the input (derived sensors, say).
        problems: counts of bad input that was left out, by kind.
    """

    name: str
    path: Path
    frame: EarthFrame
    wheelbase_m: float
    rig: StereoRig | None = None
    gnss_antenna_m: Floats = field(default_factory=lambda: np.zeros(2))
    frame_stamps_s: Floats = field(default_factory=_empty)
    frame_arrivals_s: Floats = field(default_factory=_empty)
    frame_numbers: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    images: FrameSource | None = None
    odometry: OdometryStream | None = None
    gnss: GnssStream | None = None
    reference: ReferenceStream | None = None
    scans: tuple[PoleScan, ...] = ()
    laps: tuple[Lap, ...] = ()
    notes: tuple[str, ...] = ()
    problems: Mapping[str, int] = field(default_factory=dict)

    @property
    def has_frames(self) -> bool:
        """Whether there are stereo images to look at."""
        return self.images is not None and len(self.frame_stamps_s) > 0

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last stamp over all streams; NaN for an empty drive."""
        stamps = [s for s in self._all_stamps() if len(s)]
        if not stamps:
            return (float("nan"), float("nan"))
        return (float(min(s.min() for s in stamps)), float(max(s.max() for s in stamps)))

    @property
    def duration_s(self) -> float:
        """From the first to the last stamp over all streams."""
        start, end = self.span_s
        return end - start

    def read_frame(self, row: int) -> StereoFrame:
        """The stereo pair of a row, read from the disk now.

        Raises:
            InputError: the drive has no images, or these two cannot be read.
        """
        if self.images is None:
            raise InputError(f"drive {self.name}: it has no images")
        left, right = self.images.load(row)
        return StereoFrame(
            float(self.frame_stamps_s[row]),
            float(self.frame_arrivals_s[row]),
            int(self.frame_numbers[row]),
            left,
            right,
        )

    def lap(self, name: str) -> Drive:
        """The part of the drive that a row of laps.csv names.

        Raises:
            InputError: no lap of that name.
        """
        for lap in self.laps:
            if lap.name == name:
                part = self.between(lap.start_s, lap.end_s)
                return replace(part, name=f"{self.name}:{lap.name}", laps=(lap,))
        known = ", ".join(lap.name for lap in self.laps) or "none"
        raise InputError(f"drive {self.name}: no lap is called '{name}'; its laps are: {known}")

    def between(self, start_s: float, end_s: float) -> Drive:
        """The part from `start_s` up to but without `end_s`, in every stream."""

        def rows(stamps: Floats) -> NDArray[np.bool_]:
            return np.asarray((stamps >= start_s) & (stamps < end_s))

        frames = np.flatnonzero(rows(self.frame_stamps_s))
        return replace(
            self,
            frame_stamps_s=self.frame_stamps_s[frames],
            frame_arrivals_s=self.frame_arrivals_s[frames],
            frame_numbers=self.frame_numbers[frames],
            images=self.images.keep(frames) if self.images else None,
            odometry=self.odometry.rows(rows(self.odometry.stamp_s)) if self.odometry else None,
            gnss=self.gnss.rows(rows(self.gnss.stamp_s)) if self.gnss else None,
            reference=self.reference.rows(rows(self.reference.stamp_s)) if self.reference else None,
            scans=tuple(scan for scan in self.scans if start_s <= scan.stamp_s < end_s),
        )

    def samples(self) -> Iterator[Sample]:
        """Every sample in the order of arrival; images are read as they come up.

        Samples that arrive together come in the order of their stamps, and then odometry first:
        a filter knows the motion up to an image before it gets the image.
        """
        streams = self._streams()
        if not streams:
            return
        arrival = np.concatenate([s[0] for s in streams])
        stamp = np.concatenate([s[1] for s in streams])
        kind = np.concatenate([np.full(len(s[0]), k) for k, s in enumerate(streams)])
        row = np.concatenate([np.arange(len(s[0])) for s in streams])
        for index in np.lexsort((kind, stamp, arrival)):
            yield streams[kind[index]][2](int(row[index]))

    def _streams(self) -> list[tuple[Floats, Floats, Any]]:
        streams: list[tuple[Floats, Floats, Any]] = []
        for stream in (self.odometry, self.gnss):
            if stream is not None:
                streams.append((stream.arrival_s, stream.stamp_s, stream.sample))
        if self.reference is not None:
            stamps = self.reference.stamp_s
            streams.append((stamps, stamps, self.reference.sample))
        if self.scans:
            arrivals = np.array([scan.arrival_s for scan in self.scans])
            stamps = np.array([scan.stamp_s for scan in self.scans])
            streams.append((arrivals, stamps, self.scans.__getitem__))
        if self.has_frames:
            streams.append((self.frame_arrivals_s, self.frame_stamps_s, self.read_frame))
        return streams

    def _all_stamps(self) -> list[Floats]:
        stamps = [self.frame_stamps_s, np.array([scan.stamp_s for scan in self.scans])]
        stamps += [s.stamp_s for s in (self.odometry, self.gnss, self.reference) if s is not None]
        return stamps


class Reader(Protocol):
    """One way in which drives are stored; found through the entry points `polemap.readers`."""

    @property
    def name(self) -> str: ...

    def can_read(self, path: Path) -> bool:
        """Whether the path looks like a drive of this kind; touches little."""
        ...

    def read(self, path: Path, *, seed: int) -> Drive:
        """The drive; `seed` is for sensors that have to be derived.

        Raises:
            InputError: anything in it that cannot be used, with file, place and value.
        """
        ...


def readers() -> list[Reader]:
    """Every installed reader, sorted by name."""
    found = [point.load() for point in entry_points(group="polemap.readers")]
    return sorted(found, key=lambda reader: str(reader.name))


def open_drive(path: Path, *, seed: int = 0) -> Drive:
    """Open a drive, of whatever kind it is.

    Args:
        path: folder or file.
        seed: of the noise in sensors that a kind of drive lacks and its reader derives.

    Raises:
        InputError: no such path, no reader knows it, or something in it cannot be used.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such drive")
    for reader in readers():
        if reader.can_read(path):
            return reader.read(path, seed=seed)
    kinds = ", ".join(reader.name for reader in readers())
    raise InputError(
        f"{path}: not a drive that can be read (kinds: {kinds}); a plain drive folder holds a "
        "drive.yaml"
    )
