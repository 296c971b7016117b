"""The lane of a drive: its pictures through the lane front end, and into a signal log."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.samples import Image
from polemap.electric.signals import SignalLog
from polemap.stereo.lane import LaneFinder, LaneObservation
from polemap.stereo.road_plane import Grey, MountedCamera, RoadGrid
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]
NAMES = ("heading_rad", "lateral_offset_m", "road_curvature_per_m")
SD_NAMES = ("heading_sd_rad", "lateral_offset_sd_m", "road_curvature_sd_per_m")
CORRELATIONS = {
    "corr_heading_offset": (0, 1),
    "corr_heading_curvature": (0, 2),
    "corr_offset_curvature": (1, 2),
}
# the road from above starts where the camera first sees it. Beyond 25 m little is gained and the
# flat road is what errs: on banked bends of 120 m curvature errs by 0.0018 to 22 m, 0.0028 to 32 m
FAR_M, LEAST_LENGTH_M = 25.0, 8.0


@dataclass(frozen=True, slots=True)
class LaneTrack:
    """What the lane front end said of pictures; rows are NaN where it found no lane.

    Attributes:
        stamp_s, arrival_s: `(n,)` of the pictures.
        value: `(n, 3)` heading (rad), lateral offset (m), road curvature (1/m) at the preview.
        covariance: `(n, 3, 3)` of them.
        width_m: `(n,)` of the lane.
        sides: `(n,)` how many markings were seen.
        work_s: `(n,)` what a picture took, reading not counted.
    """

    stamp_s: Floats
    arrival_s: Floats
    value: Floats
    covariance: Floats
    width_m: Floats
    sides: NDArray[np.int64]
    work_s: Floats

    @property
    def found(self) -> NDArray[np.bool_]:
        """`(n,)`."""
        return self.sides > 0


def preview_of(car: Car) -> float:
    """The car's preview point, metres ahead of its rear axle."""
    return car.cg_to_rear_m + car.preview_m


def make_finder(drive: Drive, preview_m: float, rng: np.random.Generator) -> LaneFinder:
    """The lane front end for a drive's left camera.

    Raises:
        InputError: no pictures, or a camera that does not see enough road ahead.
    """
    if drive.rig is None or not drive.has_frames:
        raise InputError(f"drive {drive.name}: it has no pictures to find a lane in")
    camera = MountedCamera(drive.rig)
    ahead = np.arange(0.0, FAR_M, 0.25)
    rows = camera.road_to_pixel(np.column_stack([ahead, np.zeros_like(ahead)]))[:, 0]
    with np.errstate(invalid="ignore"):
        seen = ahead[(rows >= 0.0) & (rows <= camera.height_px - 1.0)]
    if not len(seen) or seen[0] > FAR_M - LEAST_LENGTH_M:
        raise InputError(
            f"drive {drive.name}: its camera sees less than {LEAST_LENGTH_M:.0f} m of the road up "
            f"to {FAR_M:.0f} m; check height and pitch in vehicle_from_camera"
        )
    return LaneFinder(camera, preview_m=preview_m, grid=RoadGrid(float(seen[0]), FAR_M), rng=rng)


def follow_lane(
    drive: Drive,
    finder: LaneFinder,
    rows: Iterable[int],
    look: Callable[[int, Image, LaneObservation | None], None] | None = None,
) -> LaneTrack:
    """The lane in the left pictures of the rows of a drive, in their order.

    `look` is called with each row, its picture and what was found.
    """
    stamps, arrivals, values, covariances, widths, sides, work = ([] for _ in range(7))
    for row in rows:
        frame = drive.read_frame(row)
        start = perf_counter()
        driven = _driven(drive, frame.stamp_s)
        seen = finder.find(eight_bits(frame.left), frame.stamp_s, frame.arrival_s, driven)
        work.append(perf_counter() - start)
        stamps.append(frame.stamp_s)
        arrivals.append(max(frame.arrival_s, frame.stamp_s))
        if seen is None:
            values.append(np.full(3, np.nan))
            covariances.append(np.full((3, 3), np.nan))
        else:
            values.append(np.array([seen.heading_rad, seen.lateral_offset_m, seen.curvature_per_m]))
            covariances.append(seen.covariance)
        widths.append(float("nan") if seen is None else seen.width_m)
        sides.append(0 if seen is None else len(seen.points_m))
        if look is not None:
            look(row, frame.left, seen)
    return LaneTrack(
        np.array(stamps), np.array(arrivals), np.array(values).reshape(-1, 3),
        np.array(covariances).reshape(-1, 3, 3), np.array(widths),
        np.array(sides, dtype=np.int64), np.array(work),
    )  # fmt: skip


def _driven(drive: Drive, stamp_s: float) -> float | None:
    """The curvature that the car drives (1/m) by its odometry; None slower than walking pace."""
    odometry = drive.odometry
    if odometry is None or not len(odometry.stamp_s):
        return None
    speed = float(np.interp(stamp_s, odometry.stamp_s, odometry.speed_mps))
    if abs(speed) < 2.0:
        return None
    return float(np.interp(stamp_s, odometry.stamp_s, odometry.yaw_rate_radps)) / speed


def eight_bits(image: Image) -> Grey:
    """A picture of 8 bits; one of more is scaled so that its brightest half percent is white."""
    if image.dtype == np.uint8:
        return np.asarray(image, dtype=np.uint8)
    top = max(float(np.percentile(image[::4, ::4], 99.5)), 1.0)
    return np.asarray(np.clip(image * (255.0 / top), 0, 255), dtype=np.uint8)


def lane_log(track: LaneTrack) -> SignalLog:
    """A signal log of the pictures alone; a picture without a lane is a row without values.

    Raises:
        VehicleError: fewer than two pictures, or two of one stamp.
    """
    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    columns = dict(zip(NAMES, track.value.T, strict=True))
    columns |= dict(zip(SD_NAMES, sd.T, strict=True))
    for name, (i, j) in CORRELATIONS.items():
        columns[name] = track.covariance[:, i, j] / (sd[:, i] * sd[:, j])
    columns["lane_width_m"] = track.width_m
    columns["camera_arrival_s"] = np.where(track.found, track.arrival_s, np.nan)
    return SignalLog(track.stamp_s, columns)


def with_lanes(signals: SignalLog, track: LaneTrack) -> SignalLog:
    """A log with the pictures' rows in it; a picture at a row's stamp (1 us) joins that row.

    Camera columns that the log had give way to these. Pictures before the first or after the last
    row of the log have no signals beside them and are left out.

    Raises:
        InputError: no picture with a lane falls into the log.
    """
    lanes = lane_log(track)
    stamps = signals.stamp_s
    inside = track.found & (track.stamp_s >= stamps[0]) & (track.stamp_s <= stamps[-1])
    if not inside.any():
        raise InputError(
            f"no picture with a lane falls into the log's {stamps[0]:.2f} to {stamps[-1]:.2f} s; "
            f"{int(track.found.sum())} of {len(track.stamp_s)} pictures, from "
            f"{track.stamp_s[0]:.2f} to {track.stamp_s[-1]:.2f} s, have one"
        )
    taken = track.stamp_s[inside]
    near = np.clip(np.searchsorted(stamps, taken), 1, len(stamps) - 1)
    near = np.where(
        np.abs(stamps[near - 1] - taken) <= np.abs(stamps[near] - taken), near - 1, near
    )
    on_row = np.abs(stamps[near] - taken) < 1e-6
    at = np.where(on_row, stamps[near], taken)
    union = np.union1d(stamps, at)
    of_log, of_camera = np.searchsorted(union, stamps), np.searchsorted(union, at)
    columns = {}
    for name in {*signals.columns, *lanes.columns}:
        values = np.full(len(union), np.nan)
        if name in lanes.columns:
            values[of_camera] = lanes.columns[name][inside]
        else:
            values[of_log] = signals.columns[name]
        columns[name] = values
    return SignalLog(union, columns)


def camera_settings(signals: SignalLog) -> dict[str, float]:
    """Settings of the estimators that a log with stated deviations of its camera brings itself."""
    result = {}
    names = ("heading_sd_rad", "lateral_offset_sd_m", "curvature_sd_per_m")
    for setting, column in zip(names, SD_NAMES, strict=True):
        if signals.has(column):
            result[setting] = float(np.nanmedian(signals.columns[column]))
    if result and signals.has("heading_rad"):
        taken = np.flatnonzero(np.isfinite(signals.columns["heading_rad"]))
        stamps = signals.stamp_s[taken]
        if len(taken) > 1:
            result["camera_period_s"] = float(np.clip(np.median(np.diff(stamps)), 1e-3, 1.0))
        if "camera_arrival_s" in signals.columns:
            late = np.maximum(signals.columns["camera_arrival_s"][taken] - stamps, 0.0)
            delay = float(np.nanmedian(late)) if np.isfinite(late).any() else 0.0
            result["camera_delay_s"] = min(delay, 1.0)
            # pictures that are on their way at once, told by the longest delay
            longest = float(np.nanmax(late)) if np.isfinite(late).any() else 0.0
            result["camera_slots"] = int(
                np.clip(np.ceil(longest / result.get("camera_period_s", 1.0)), 1, 8)
            )
    return result
