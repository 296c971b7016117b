"""A drive: its streams, and one merged iterator over them in the order of arrival."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.merge import SampleRows, merge_streams
from polemap.drivelog.samples import Image, Sample, StereoFrame
from polemap.drivelog.source_names import SourceNames
from polemap.drivelog.streams import (
    GnssStream,
    OdometryCorrection,
    OdometryStream,
    ReferenceStream,
)
from polemap.stereo.rig import StereoRig
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]


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
        car: parameters of the car, None where the drive names no car file.
        rig: stereo camera, None where the drive has no images.
        gnss_antenna_m: `(2,)` antenna in the vehicle frame.
        frame_stamps_s, frame_arrivals_s: `(n,)` of the stereo pairs, sorted by stamp.
        frame_numbers: `(n,)` number of each pair in the recording (gaps are real).
        odometry, gnss, reference: None where the drive lacks the sensor.
        odometry_correction: what the odometry has been corrected by already.
        scans: poles that were detected elsewhere, sorted by stamp.
        laps: named parts.
        notes: what a reader of a result must know about the input (derived sensors, say).
        problems: counts of bad input that was left out, by kind.
        findings: what the reader itself saw in the input that cannot be right.
        odometry_is_derived: whether the odometry was made from the reference.
        odometry_is_cameras: whether it is the stereo camera's.
        names: what the source calls its streams.
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
    odometry_correction: OdometryCorrection = field(default_factory=OdometryCorrection)
    gnss: GnssStream | None = None
    reference: ReferenceStream | None = None
    scans: tuple[Detections, ...] = ()
    laps: tuple[Lap, ...] = ()
    notes: tuple[str, ...] = ()
    problems: Mapping[str, int] = field(default_factory=dict)
    car: Car | None = None
    findings: tuple[Finding, ...] = ()
    odometry_is_derived: bool = False
    odometry_is_cameras: bool = False
    names: SourceNames = field(default_factory=SourceNames)

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
        """The part of the drive that a row of laps.csv names, or two rows as FIRST:LAST.

        Raises:
            InputError: no lap of that name, or the last ends before the first begins.
        """
        named = {lap.name: lap for lap in reversed(self.laps)}
        ends = [name, name] if name in named or ":" not in name else name.split(":", 1)
        missing = next((end for end in ends if end not in named), None)
        if missing is not None:
            known = ", ".join(lap.name for lap in self.laps) or "none"
            raise InputError(
                f"drive {self.name}: no lap is called '{missing}'; its laps are: {known}"
            )
        start_s, end_s = named[ends[0]].start_s, named[ends[1]].end_s
        if end_s <= start_s:
            raise InputError(f"drive {self.name}: lap '{ends[1]}' ends before '{ends[0]}' begins")
        laps = tuple(lap for lap in self.laps if start_s <= lap.start_s and lap.end_s <= end_s)
        return replace(self.between(start_s, end_s), name=f"{self.name}:{name}", laps=laps)

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
            odometry=self.odometry.take(rows(self.odometry.stamp_s)) if self.odometry else None,
            gnss=self.gnss.take(rows(self.gnss.stamp_s)) if self.gnss else None,
            reference=self.reference.take(rows(self.reference.stamp_s)) if self.reference else None,
            scans=tuple(scan for scan in self.scans if start_s <= scan.stamp_s < end_s),
        )

    def samples(self) -> Iterator[Sample]:
        """Every sample in the order of arrival; images are read as they come up.

        Samples that arrive together come in the order of their stamps, and then odometry first:
        a filter knows the motion up to an image before it gets the image.
        """
        return merge_streams(self._streams())

    def _streams(self) -> list[SampleRows[Sample]]:
        streams: list[SampleRows[Sample]] = [
            SampleRows(stream.arrival_s, stream.stamp_s, stream.sample)
            for stream in (self.odometry, self.gnss)
            if stream is not None
        ]
        if self.reference is not None:
            stamps = self.reference.stamp_s
            streams.append(SampleRows(stamps, stamps, self.reference.sample))
        if self.scans:
            arrivals = np.array([scan.arrival_s for scan in self.scans])
            stamps = np.array([scan.stamp_s for scan in self.scans])
            streams.append(SampleRows(arrivals, stamps, self.scans.__getitem__))
        if self.has_frames:
            streams.append(SampleRows(self.frame_arrivals_s, self.frame_stamps_s, self.read_frame))
        return streams

    def _all_stamps(self) -> list[Floats]:
        stamps = [self.frame_stamps_s, np.array([scan.stamp_s for scan in self.scans])]
        stamps += [s.stamp_s for s in (self.odometry, self.gnss, self.reference) if s is not None]
        return stamps
