"""The reference against itself: its yaw against the way its positions take."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import convergence_rad
from polemap.drivelog.plausibility.jitter import without_jitter
from polemap.drivelog.plausibility.odometer import Odometer, common_spans
from polemap.drivelog.source_names import SourceNames
from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.pose import rotate_back, wrap_angle

Floats = NDArray[np.float64]

_CHORD_M = 1.0
_STEP_MAX_S = 2.0
# clean references: median |course - yaw| of 0.001 to 0.009 rad
_YAW_DOUBT_RAD, _YAW_WRONG_RAD = np.radians(4.0), np.radians(15.0)
_FIT_RAD = 0.12
# clean references: less than 0.2 degrees of constant between yaw and course on straights
_YAW_CONSTANT_RAD, _STRAIGHT_PER_M, _STRAIGHT_MIN = np.radians(0.8), 0.01, 20
# a rear axle slips outward by about this angle per lateral acceleration, give or take
_SLIP, _SLIP_SD = -0.006, 0.004
_LEVER_M, _LEVER_SDS = 0.5, 6.0
_ACROSS_M = 0.6
_TURN_MIN_RAD = 1.0
_UTM_EAST_M, _UTM_NORTH_M = (0.0, 1.0e6), (-1.0e3, 1.0e7)


@dataclass(frozen=True, slots=True)
class Chords:
    """Steps of about a metre along a reference, `(n,)` each."""

    course_rad: Floats
    yaw_rad: Floats
    turn_rad: Floats
    along_m: Floats
    left_m: Floats
    duration_s: Floats


def find_chords(reference: ReferenceStream) -> Chords | None:
    """Chords between poses a metre apart; None where the reference hardly moves."""
    reference = without_jitter(reference)
    points = reference.poses[:, :2]
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    keep = np.unique(np.floor(way / _CHORD_M), return_index=True)[1]
    if len(keep) < 6:
        return None
    poses, stamps = reference.poses[keep], reference.stamp_s[keep]
    yaw = np.unwrap(poses[:, 2])
    step, duration = np.diff(poses[:, :2], axis=0), np.diff(stamps)
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    along, across = rotate_back(step, middle).T
    chords = Chords(
        np.arctan2(step[:, 1], step[:, 0]),
        middle,
        np.diff(yaw),
        along,
        across,
        duration,
    )
    # a jump in place or time is no motion
    length = np.hypot(step[:, 0], step[:, 1])
    usable = (duration < _STEP_MAX_S) & (length < 100.0 * np.maximum(duration, 1e-3) + 1.0)
    if usable.sum() < 5:
        return None
    return Chords(*(getattr(chords, name)[usable] for name in Chords.__slots__))


def yaw_findings(drive: Drive, chords: Chords, turn_ratio: float) -> list[Finding]:
    """Whether the yaw points along the way.

    Args:
        turn_ratio: turn of the odometry over that of the reference's yaw, NaN where unknown: a
            mirrored course with yaws that turn like the odometry means mirrored positions.
    """
    course, yaw = chords.course_rad, chords.yaw_rad
    off = _median_off(course, yaw)
    if off < _YAW_DOUBT_RAD:
        return _constant_findings(drive, chords)
    guesses = {
        "yaw points backward": (yaw + pi, "turn the yaw by 180 degrees"),
        "yaw is from north, clockwise": (pi / 2 - yaw, "write pi/2 - yaw"),
        "yaw is from north, counter-clockwise": (yaw + pi / 2, "write yaw + pi/2"),
        "yaw is clockwise from east": (-yaw, "change the sign of the yaw"),
        "yaw is from south, clockwise": (-pi / 2 - yaw, "write -pi/2 - yaw"),
    }
    fits = {name: _median_off(course, guess) for name, (guess, _) in guesses.items()}
    name = min(fits, key=lambda key: fits[key])
    value = f"its yaw is {np.degrees(off):.1f} degrees off its course in the median"
    expected = f"yaw along the course within {np.degrees(_YAW_DOUBT_RAD):.0f} degrees"
    mirrored = (name.endswith("clockwise") and "counter" not in name) or "clockwise from" in name
    if fits[name] < _FIT_RAD and mirrored and turn_ratio > 0.0:
        return [
            Finding(
                "reference_axes", "error", drive.names.reference,
                f"{value}, but turns like the odometry: its positions are mirrored",
                "east to the east and north to the north", "exchange east and north",
            )
        ]  # fmt: skip
    if fits[name] < _FIT_RAD:
        return [
            Finding(
                "reference_yaw", "error", drive.names.reference, f"{value}; {name}", expected,
                f"{guesses[name][1]} (a yaw is counter-clockwise from grid east)",
            )
        ]  # fmt: skip
    if (
        _median_off(np.degrees(np.unwrap(course)), yaw) < 0.6
        or _median_off(course, np.radians(yaw)) < _FIT_RAD
    ):
        return [
            Finding(
                "reference_yaw_unit", "error", drive.names.reference, f"{value}; it is in degrees",
                expected, "write the yaw in radians",
            )
        ]  # fmt: skip
    constant = float(np.angle(np.mean(np.exp(1j * (course - yaw)))))
    spread = _median_off(course, yaw + constant)
    severe = off > _YAW_WRONG_RAD
    text = f"; a constant {np.degrees(constant):.1f} degrees" if spread < 0.5 * off else ", varying"
    return [
        Finding(
            "reference_yaw", "error" if severe else "warning", drive.names.reference, value + text,
            expected, "check the yaw's convention and the alignment of the reference system",
        )
    ]  # fmt: skip


def mirrored_finding(names: SourceNames, turn_ratio: float) -> Finding:
    """Positions and yaws of a left-handed frame: odometry and poles turn the other way."""
    return Finding(
        "reference_axes", "error", names.reference,
        f"it turns against {names.odometry} (ratio {turn_ratio:.3g}), with which {names.poles} "
        "agrees: its frame is left-handed",
        "east to the east, north to the north, yaw counter-clockwise from east",
        "exchange east and north (as of NED) and write pi/2 - yaw, or change the sign of one axis "
        "and of the yaw",
    )  # fmt: skip


def _constant_findings(drive: Drive, chords: Chords) -> list[Finding]:
    """A small constant between yaw and course: a mounting angle, or a geographic north."""
    straight = np.abs(chords.turn_rad) < _STRAIGHT_PER_M * np.maximum(chords.along_m, 1e-3)
    if straight.sum() < _STRAIGHT_MIN:
        return []
    off = wrap_angle(chords.yaw_rad - chords.course_rad)[straight]
    constant = float(np.median(off))
    spread = float(np.median(np.abs(off - constant)))
    if abs(constant) < max(_YAW_CONSTANT_RAD, spread):
        return []
    remedy = f"subtract {np.degrees(constant):.2f} degrees, or align the reference system"
    if drive.frame.is_utm and drive.reference is not None:
        middle = np.median(drive.reference.poses[:, :2], axis=0)
        north = float(convergence_rad(drive.frame, middle[None])[0])
        if abs(abs(constant) - abs(north)) < np.radians(0.3):
            remedy = (
                f"count it from grid east, not geographic: the norths are {np.degrees(north):.2f} "
                "degrees apart here"
            )
    return [
        Finding(
            "reference_yaw", "warning", drive.names.reference,
            f"its yaw is {np.degrees(constant):+.2f} degrees off its course where it goes straight",
            f"within {np.degrees(_YAW_CONSTANT_RAD):.1f} degrees", remedy,
        )
    ]  # fmt: skip


def lever_findings(drive: Drive, chords: Chords) -> list[Finding]:
    """Whether the reference point is the rear axle, which does not move sideways but for slip."""
    turn, way = chords.turn_rad, chords.along_m
    if np.abs(turn).sum() < _TURN_MIN_RAD:
        return []
    speed = way / np.maximum(chords.duration_s, 1e-3)
    design = np.stack([turn, turn * speed**2, way], axis=1)
    ahead, sd = _lever(design, chords.left_m)
    known = abs(float(drive.gnss_antenna_m[0]))
    at_antenna = known >= 0.3 and abs(ahead - drive.gnss_antenna_m[0]) < 0.15
    least = 0.3 if at_antenna else _LEVER_M
    if abs(ahead) < least or abs(ahead) < _LEVER_SDS * sd:
        return []
    where = "ahead of" if ahead > 0 else "behind"
    what = ", where the GNSS antenna is" if at_antenna else ""
    return [
        Finding(
            "reference_lever_arm", "warning", drive.names.reference,
            f"it moves in bends as a point {abs(ahead):.2f} m {where} the rear axle{what}",
            f"the rear axle (within {_LEVER_M:.1f} m)",
            "shift the positions along the yaw to the rear axle",
        )
    ]  # fmt: skip


def _lever(design: Floats, left: Floats) -> tuple[float, float]:
    """Distance ahead of the axle and its sd by least squares that outliers do not lead."""
    weight: Floats = np.ones(len(left))
    result: Floats = np.zeros(3)
    information: Floats = np.eye(3)
    scale = 1.0
    prior = np.array([0.0, 1.0, 0.0]) / _SLIP_SD
    for _ in range(10):
        seen: Floats = design.T @ (design * weight[:, None]) / scale**2
        information = seen + np.outer(prior, prior)
        information = np.asarray(information + np.diag([1e-6, 0.0, 1e4]))
        vector: Floats = design.T @ (weight * left) / scale**2 + prior * (_SLIP / _SLIP_SD)
        result = np.asarray(np.linalg.solve(information, vector), dtype=np.float64)
        rest = np.abs(left - design @ result)
        scale = 1.4826 * float(np.median(rest)) + 1e-3
        weight = 1.0 / (1.0 + (rest / (2.0 * scale)) ** 2)
    return float(result[0]), float(np.sqrt(np.linalg.inv(information)[0, 0]))


def across_findings(odometry: Odometer, reference: Odometer) -> list[Finding]:
    """Whether the reference point lies on the car's middle line: beside it bends are longer."""
    way_a, _, way_b, turn = common_spans(odometry, reference, 2.0)
    moving = np.abs(way_b) > 1.0
    if moving.sum() < 8 or np.abs(turn[moving]).sum() < _TURN_MIN_RAD:
        return []
    # a point to the left of the rear axle's middle goes y times the turn less in a left bend
    design = np.stack([way_a, -turn], axis=1)[moving]
    target = way_b[moving]
    weight: Floats = np.ones(len(target))
    fit: Floats = np.zeros(2)
    spread = 1.0
    for _ in range(10):
        root = np.sqrt(weight)
        fit = np.asarray(np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0])
        error = np.abs(target - design @ fit)
        spread = 1.4826 * float(np.median(error)) + 1e-3
        weight = np.asarray(1.0 / (1.0 + (error / (2.0 * spread)) ** 2))
    information = design.T @ (design * weight[:, None])
    left = float(fit[1])
    if not np.isfinite(left):
        return []
    sd = spread * float(np.sqrt(np.linalg.pinv(information)[1, 1]))
    if abs(left) < _ACROSS_M or abs(left) < _LEVER_SDS * sd:
        return []
    side = "left" if left > 0 else "right"
    return [
        Finding(
            "reference_lever_arm", "warning", reference.name,
            f"in bends it goes as a point {abs(left):.2f} m {side} of that of {odometry.name}",
            f"the middle of the rear axle (within {_ACROSS_M:.1f} m)",
            "shift the positions across the yaw to the middle of the rear axle",
        )
    ]  # fmt: skip


def range_findings(drive: Drive) -> list[Finding]:
    """Coordinates that a UTM zone does not have."""
    if drive.reference is None or not drive.frame.is_utm or not len(drive.reference):
        return []
    east, north = np.median(drive.reference.poses[:, :2], axis=0)
    inside = _UTM_EAST_M[0] < east < _UTM_EAST_M[1] and _UTM_NORTH_M[0] < north < _UTM_NORTH_M[1]
    if inside:
        return []
    exchanged = _UTM_EAST_M[0] < north < _UTM_EAST_M[1] and east > _UTM_EAST_M[1]
    return [
        Finding(
            "reference_axes" if exchanged else "reference_place", "error", drive.names.reference,
            f"east {east:.0f}, north {north:.0f} m",
            "east of 0 to 1000 km and north of 0 to 10000 km in a UTM zone",
            "exchange east and north" if exchanged
            else f"write coordinates of the frame of {drive.names.head}, or name theirs",
        )
    ]  # fmt: skip


def _median_off(course: Floats, yaw: Floats) -> float:
    return float(np.median(np.abs(wrap_angle(course - yaw))))
