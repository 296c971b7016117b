"""The camera against the motion: how its calibration and mounting see the car go.

Features of a stereo pair are followed into the next one; with their disparities, the calibration
turns both into the camera's motion in space. Its length against the way of the odometry tells
focal length times baseline, its direction against the mounting tells principal point and angles,
and points below the road tell that the picture stands on its head or the camera higher.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.features import Grey, follow_rows
from polemap.drivelog.plausibility.odometer import Odometer, of_odometry, of_reference
from polemap.drivelog.source_names import CalibrationNames
from polemap.stereo.odometry.motion import fit_motion
from polemap.stereo.odometry.sights import points_of
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import rotate
from polemap.vehicle.pose import rotation as plane_rotation

Floats = NDArray[np.float64]

_WAY_M, _STEP_MAX_S = (0.4, 4.0), 0.5
_POINTS_MIN, _PAIRS_MIN = 20, 3
_SPREAD_PX = 0.5
# KITTI and simulated pairs: lengths within 3 %, directions within 0.7 degrees in the median
_SCALE_DOUBT, _SCALE_WRONG = 1.12, 1.3
_ANGLE_DOUBT_RAD, _ANGLE_WRONG_RAD = np.radians(2.5), np.radians(10.0)
# small pictures of a narrow or empty view scatter: the median is off by so many of its sds
_SDS = 4.0
# the lowest tenth of the points within this: the road, give or take its slope; clean pictures have
# it at -0.1 m or above, pictures that stand on their head at -2 m or below
_NEAR_M, _NEAR_MIN, _LOW_SHARE = 25.0, 30, 10.0
_BELOW_DOUBT_M, _BELOW_WRONG_M = 0.8, 1.5
_STREAMS_AGREE = 1.1


@dataclass(frozen=True, slots=True)
class StereoMatches:
    """Features seen in two pairs: places `(n, 2)` in the left pictures, disparities `(n,)`, px."""

    first_px: Floats
    first_disparity_px: Floats
    second_px: Floats
    second_disparity_px: Floats


@dataclass(frozen=True, slots=True)
class SeenMotion:
    """What one pair of pairs tells: length over that of the odometry, direction off the mounting.

    Attributes:
        up_rad, left_rad: by how much the camera seems to rise, and to go to the left.
        points_vehicle_m: `(n, 3)` in the vehicle frame.
    """

    scale: float
    up_rad: float
    left_rad: float
    points_vehicle_m: Floats


def moving_rows(drive: Drive) -> NDArray[np.int64]:
    """Rows of pairs from which the car goes on to the next one by a metre or so."""
    motion = _motion(drive)
    stamps = drive.frame_stamps_s
    if motion is None or len(stamps) < 2:
        return np.empty(0, dtype=np.int64)
    way, _, known = motion.spans(stamps[:-1], stamps[1:])
    step = np.diff(stamps)
    return np.flatnonzero(
        known & (np.abs(way) > _WAY_M[0]) & (np.abs(way) < _WAY_M[1]) & (step < _STEP_MAX_S)
    )


def _motion(drive: Drive) -> Odometer | None:
    if drive.odometry is not None and len(drive.odometry) > 10:
        return of_odometry(drive.odometry)
    if drive.reference is not None and len(drive.reference) > 10:
        return of_reference(drive.reference)
    return None


def match_next(
    left: Grey, places_px: Floats, steps_px: Floats, next_left: Grey, next_right: Grey
) -> StereoMatches:
    """Follow the features of a pair, found in the right picture by `steps_px`, into the next."""
    disparity = -steps_px[:, 0]
    usable = disparity > 1.0
    corners = places_px[usable].astype(np.float32)[:, None]
    then, there, first = follow_rows(left, next_left, corners)
    later = (then + there).astype(np.float32)
    again, across, second = follow_rows(next_left, next_right, later[:, None])
    keep = -across[:, 0] > 1.0
    return StereoMatches(
        then[second][keep],
        disparity[usable][first[second]][keep],
        again[keep],
        -across[keep, 0],
    )


def see_motion(drive: Drive, row: int, matches: StereoMatches) -> SeenMotion | None:
    """The camera's motion from a row to the next, against what the odometry expects of it."""
    rig, motion = drive.rig, _motion(drive)
    if rig is None or motion is None or len(matches.first_px) < _POINTS_MIN:
        return None
    try:
        next_from_first, points = fit_step(rig, matches)
    except np.linalg.LinAlgError:
        # numbers that no camera has; `absolute` names them
        return None
    mount = rig.vehicle_from_camera
    turned, place = mount.rotation(), np.array([mount.x_m, mount.y_m, mount.z_m])
    moved = turned @ (-next_from_first[:3, :3].T @ next_from_first[:3, 3])
    stamps = drive.frame_stamps_s
    way, turn, _ = (float(v[0]) for v in motion.spans(stamps[[row]], stamps[[row + 1]]))
    lever = (plane_rotation(turn) - np.eye(2)) @ place[:2]
    expected = rotate([way, 0.0], turn / 2.0) + lever
    length = float(np.hypot(*expected))
    if length < _WAY_M[0] / 2.0 or not np.isfinite(moved).all():
        return None
    sign = 1.0 if way > 0.0 else -1.0
    return SeenMotion(
        float(np.linalg.norm(moved)) / length,
        float(np.arctan2(sign * moved[2], np.hypot(moved[0], moved[1]))),
        float(np.arctan2(expected[0] * moved[1] - expected[1] * moved[0], expected @ moved[:2])),
        points @ turned.T + place,
    )


def fit_step(rig: StereoRig, seen: StereoMatches) -> tuple[Floats, Floats]:
    """Motion `(4, 4)` of the points `(n, 3)` into the next camera's axes."""
    first, second = (
        np.column_stack([place, place[:, 0] - disparity])
        for place, disparity in (
            (seen.first_px, seen.first_disparity_px), (seen.second_px, seen.second_disparity_px),
        )
    )  # fmt: skip
    noise = _SPREAD_PX**2 * np.eye(3)
    fit = fit_motion(rig, first, np.tile(noise, (len(first), 1, 1)), second, noise, np.eye(4))
    return fit.current_from_previous, points_of(rig, first)


def camera_findings(drive: Drive, seen: list[SeenMotion]) -> list[Finding]:
    """What the motions that the camera saw say of its calibration and mounting."""
    rig, motion = drive.rig, _motion(drive)
    if rig is None or motion is None or len(seen) < _PAIRS_MIN:
        return []
    found, names = [], drive.names.calibration
    scale = float(np.median([one.scale for one in seen]))
    scales = np.log(np.maximum([one.scale for one in seen], 1e-6))
    off_scale = not 1.0 / _SCALE_DOUBT < scale < _SCALE_DOUBT
    if off_scale and _stands_out(scales) and _confirmed(drive):
        severe = not 1.0 / _SCALE_WRONG < scale < _SCALE_WRONG
        found.append(
            Finding(
                "camera_scale", "error" if severe else "warning", "camera",
                f"the pictures show {scale:.2f} times the way of {motion.name} ({len(seen)} pairs)",
                f"1 within {100 * (_SCALE_DOUBT - 1):.0f} %",
                f"check {names.focal} ({rig.focal_px:g}) and {names.baseline} "
                f"({rig.baseline_m:g}): they are of the rectified pictures, at their size",
            )
        )  # fmt: skip
    for kind, angles, sense, name, size, angle in (
        ("camera_pitch", [one.up_rad for one in seen], ("rises", "sinks"), names.centre_y,
         rig.cy_px, names.pitch),
        ("camera_yaw", [one.left_rad for one in seen], ("drifts left", "drifts right"),
         names.centre_x, rig.cx_px, names.yaw),
    ):  # fmt: skip
        off = float(np.median(angles))
        if abs(off) < _ANGLE_DOUBT_RAD or not _stands_out(np.array(angles)):
            continue
        pixels = abs(rig.focal_px * np.tan(off))
        found.append(
            Finding(
                kind, "error" if abs(off) > _ANGLE_WRONG_RAD else "warning", "camera",
                f"the car goes straight on, the camera {sense[off < 0.0]} by "
                f"{abs(np.degrees(off)):.1f} degrees",
                f"within {np.degrees(_ANGLE_DOUBT_RAD):.1f} degrees",
                f"check {name} ({size:g}), which may be off by {pixels:.0f} px, or {angle} by "
                f"{abs(off):.3f} rad",
            )
        )  # fmt: skip
    points = np.concatenate([one.points_vehicle_m for one in seen])
    return found + _below(points, rig, names)


def _stands_out(values: Floats) -> bool:
    """Whether the median of what the pairs tell is off zero by more than their scatter explains."""
    sd = float(values.std(ddof=1)) / float(np.sqrt(len(values)))
    return abs(float(np.median(values))) > _SDS * sd


def _confirmed(drive: Drive) -> bool:
    """Whether odometry and reference, if both are there, tell the same way."""
    if drive.odometry is None or drive.reference is None:
        return True
    if min(len(drive.odometry), len(drive.reference)) <= 10:
        return True
    start, end = drive.frame_stamps_s[[0]], drive.frame_stamps_s[[-1]]
    ways = [
        t.spans(start, end) for t in (of_odometry(drive.odometry), of_reference(drive.reference))
    ]
    (way_a, _, known_a), (way_b, _, known_b) = ways
    if not (known_a[0] and known_b[0]):
        return True
    ratio = abs(float(way_a[0])) / max(abs(float(way_b[0])), 1e-3)
    return 1.0 / _STREAMS_AGREE < ratio < _STREAMS_AGREE


def _below(points: Floats, rig: StereoRig, names: CalibrationNames) -> list[Finding]:
    """Points that stand below the road."""
    near = points[np.hypot(points[:, 0], points[:, 1]) < _NEAR_M]
    if len(near) < _NEAR_MIN:
        return []
    low = float(np.percentile(near[:, 2], _LOW_SHARE))
    if low > -_BELOW_DOUBT_M:
        return []
    over = low < -_BELOW_WRONG_M
    height = rig.vehicle_from_camera.z_m
    return [
        Finding(
            "camera_upside_down" if over else "camera_height", "error" if over else "warning",
            "camera", f"{_LOW_SHARE:.0f} % of what stands within {_NEAR_M:.0f} m lies {-low:.1f} m "
            "or more below the road", f"nothing lower than {_BELOW_DOUBT_M:g} m",
            "turn the pictures by 180 degrees and exchange left and right" if over
            else f"check {names.height} ({height:g} m), {names.pitch} and {names.centre_y}",
        )
    ]  # fmt: skip
