"""What no car does and no camera has, with nothing to compare it with."""

from __future__ import annotations

from math import atan, degrees

import numpy as np

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.units import LENGTH_UNITS, named_unit

_SPEED_MPS, _YAW_RATE_RADPS = 100.0, 3.0
_LATERAL_MPS2 = 15.0
_WHEELBASE_M, _WHEELBASE_TYPICAL_M = (1.0, 8.0), 2.8
_BASELINE_M = (0.03, 3.0)
_VIEW_DEG = (10.0, 150.0)
_HDOP_DOUBT = 20.0
_DUPLICATES_MAX = 0.05
_POLE_FAR_M, _POLE_NEAR_M = 200.0, 1.0
_POLE_WIDTH_M = 3.0
_PROBABILITY_DOUBT, _PROBABILITY_WRONG = 0.3, 0.02


def vehicle_findings(drive: Drive) -> list[Finding]:
    """Wheelbase and GNSS antenna."""
    found = []
    low, high = _WHEELBASE_M
    if not low <= drive.wheelbase_m <= high:
        unit = named_unit(drive.wheelbase_m / _WHEELBASE_TYPICAL_M, LENGTH_UNITS, 0.6)
        found.append(
            Finding(
                "wheelbase", "error", drive.names.head,
                f"{drive.names.calibration.wheelbase} is {drive.wheelbase_m:g}",
                f"{low:g} to {high:g} m",
                f"write it in metres{f' (it looks like {unit})' if unit else ''}",
            )
        )  # fmt: skip
    x, y = drive.gnss_antenna_m
    if abs(x) > 15.0 or abs(y) > 3.0:
        found.append(
            Finding(
                "gnss_antenna", "error", drive.names.head, f"gnss_antenna at x {x:g}, y {y:g} m",
                "within 15 m along and 3 m across the car", "write it in metres, y to the left",
            )
        )  # fmt: skip
    return found


def odometry_findings(drive: Drive) -> list[Finding]:
    """Speeds, yaw rates and their product."""
    odometry = drive.odometry
    if odometry is None or len(odometry) < 5:
        return []
    speed, rate = odometry.speed_mps, odometry.yaw_rate_radps
    found = []
    fast = float(np.percentile(np.abs(speed), 99))
    if fast > _SPEED_MPS:
        found.append(
            Finding(
                "speed_range", "error", drive.names.odometry, f"speeds to {fast:.0f} m/s",
                f"below {_SPEED_MPS:.0f} m/s", "write the speed in m/s",
            )
        )  # fmt: skip
    moving = np.abs(speed) > 0.5
    if moving.sum() > 5 and np.mean(speed[moving] < 0.0) > 0.7:
        found.append(
            Finding(
                "speed_sign", "warning", drive.names.odometry,
                f"{100 * np.mean(speed[moving] < 0.0):.0f} % of the motion is backward",
                "forward positive", "change the sign of the speed if the car drove forward",
            )
        )  # fmt: skip
    turning = float(np.percentile(np.abs(rate), 98))
    lateral = float(np.percentile(np.abs(speed * rate), 98))
    if turning > _YAW_RATE_RADPS or lateral > _LATERAL_MPS2:
        found.append(
            Finding(
                "yaw_rate_range", "error", drive.names.odometry,
                f"yaw rates to {turning:.2f} rad/s, lateral accelerations to {lateral:.0f} m/s2",
                f"below {_YAW_RATE_RADPS:g} rad/s and {_LATERAL_MPS2:g} m/s2",
                "write the yaw rate in rad/s and the speed in m/s",
            )
        )  # fmt: skip
    # wheels steer by at most 45 degrees or so: the rear axle's circle is no smaller than this
    wheelbase = drive.wheelbase_m
    steady = np.abs(speed) > 2.0
    if steady.sum() > 20 and _WHEELBASE_M[0] <= wheelbase <= _WHEELBASE_M[1]:
        bend = float(np.percentile(np.abs(rate[steady] / speed[steady]), 95))
        if bend * wheelbase > 1.5 and not found:
            found.append(
                Finding(
                    "curvature", "error", drive.names.odometry,
                    f"bends of {1.0 / bend:.2f} m radius at speed",
                    f"no less than {wheelbase:.1f} m, which wheels can steer",
                    "check the units of speed and yaw rate",
                )
            )  # fmt: skip
    return found


def camera_findings(drive: Drive) -> list[Finding]:
    """Intrinsics, baseline and mounting."""
    rig = drive.rig
    if rig is None:
        return []
    found, names = [], drive.names.calibration

    def wrong(kind: str, value: str, expected: str, remedy: str, severe: bool = True) -> None:
        severity = "error" if severe else "warning"
        found.append(Finding(kind, severity, "camera", value, expected, remedy))  # type: ignore[arg-type]

    low, high = _BASELINE_M
    if not low <= rig.baseline_m <= high:
        unit = named_unit(rig.baseline_m / 0.4, LENGTH_UNITS, 1.0)
        hint = f" (it looks like {unit})" if unit else ""
        wrong("baseline", f"{names.baseline} is {rig.baseline_m:g}", f"{low:g} to {high:g} m",
              f"write it in metres{hint}")  # fmt: skip
    view = degrees(2.0 * atan(rig.width_px / 2.0 / rig.focal_px))
    if not _VIEW_DEG[0] <= view <= _VIEW_DEG[1]:
        wrong("focal_length", f"{names.focal} {rig.focal_px:g} on {rig.width_px} px sees "
              f"{view:.0f} degrees", f"{_VIEW_DEG[0]:.0f} to {_VIEW_DEG[1]:.0f} degrees",
              "write the focal length of the rectified pictures in pixels, not in mm")  # fmt: skip
    for name, centre, size in (
        (names.centre_x, rig.cx_px, rig.width_px),
        (names.centre_y, rig.cy_px, rig.height_px),
    ):
        if not 0.2 * size < centre < 0.8 * size:
            wrong("principal_point", f"{name} is {centre:g} in pictures of {size} px",
                  f"{0.2 * size:.0f} to {0.8 * size:.0f} px",
                  "take it from the calibration of these pictures",
                  severe=not 0.0 < centre < size)  # fmt: skip
    mount = rig.vehicle_from_camera
    if abs(mount.x_m) > 15.0 or abs(mount.y_m) > 2.5 or not 0.2 < mount.z_m < 6.0:
        wrong("camera_place", f"the camera stands at x {mount.x_m:g}, y {mount.y_m:g}, "
              f"z {mount.z_m:g} m", "within 15 m along, 2.5 m across, 0.2 to 6 m up",
              "write metres from the ground under the rear axle")  # fmt: skip
    tilt = max(abs(mount.roll_rad), abs(mount.pitch_rad))
    if tilt > 0.5 or abs(mount.yaw_rad) > 0.8:
        wrong("camera_angles", f"roll {mount.roll_rad:g}, pitch {mount.pitch_rad:g}, yaw "
              f"{mount.yaw_rad:g} rad", "roll and pitch below 0.5, yaw below 0.8 rad",
              "write radians; all zero means straight ahead and level")  # fmt: skip
    return found


def gnss_findings(drive: Drive) -> list[Finding]:
    """Dilution of precision, and fixes that stand still."""
    gnss = drive.gnss
    if gnss is None or len(gnss) < 3:
        return []
    found = []
    hdop = float(np.median(gnss.hdop))
    if hdop > _HDOP_DOUBT:
        found.append(
            Finding(
                "hdop", "warning", drive.names.gnss, f"hdop is {hdop:.1f} in the median",
                f"below {_HDOP_DOUBT:.0f}", "write the dilution of precision, not an accuracy",
            )
        )  # fmt: skip
    unusable = drive.problems.get("gnss_hdop_unusable", 0)
    if unusable > 0.1 * len(gnss):
        found.append(
            Finding(
                "hdop", "warning", drive.names.gnss,
                f"hdop is no positive number in {unusable} rows",
                "a dilution of precision above 0", "taken as 1; write what the receiver says",
            )
        )  # fmt: skip
    points = np.stack([gnss.east_m, gnss.north_m], axis=1)
    if len(gnss) > 10 and np.ptp(points, axis=0).max() < 1e-6:
        found.append(
            Finding(
                "gnss_frozen", "warning", drive.names.gnss,
                f"all {len(gnss)} fixes are the same",
                "fixes that move",
                f"check the receiver; leave {drive.names.gnss} away if it had no fix",
            )
        )  # fmt: skip
    return found


def pole_findings(drive: Drive) -> list[Finding]:
    """Ranges and widths of poles that were detected elsewhere."""
    points = [scan.points_vehicle_m for scan in drive.scans if len(scan)]
    if not points:
        return []
    found = []
    distance = float(np.median(np.hypot(*np.concatenate(points).T)))
    if not _POLE_NEAR_M < distance < _POLE_FAR_M:
        found.append(
            Finding(
                "pole_range", "error", drive.names.poles,
                f"poles {distance:.3g} m away in the median",
                f"{_POLE_NEAR_M:g} to {_POLE_FAR_M:g} m", "write x and y in metres",
            )
        )  # fmt: skip
    widths = np.concatenate([scan.width_m for scan in drive.scans if len(scan)])
    widths = widths[np.isfinite(widths)]
    if len(widths) and not 0.0 <= np.median(widths) <= _POLE_WIDTH_M:
        found.append(
            Finding(
                "pole_width", "error", drive.names.poles,
                f"poles {np.median(widths):.3g} m wide in the median",
                f"0 to {_POLE_WIDTH_M:g} m", "write width_m in metres, or leave the cells empty",
            )
        )  # fmt: skip
    found += _probabilities(drive)
    variances = np.concatenate([scan.covariance_m2[:, 0, 0] for scan in drive.scans if len(scan)])
    if np.median(variances) > 25.0:
        found.append(
            Finding(
                "pole_variance", "warning", drive.names.poles,
                f"var_x_m2 is {np.median(variances):.3g} in the median", "below 25 m2",
                "write variances in square metres",
            )
        )  # fmt: skip
    return found


def _probabilities(drive: Drive) -> list[Finding]:
    """Probabilities of poles that are percentages, or so low that no pole is believed."""
    given = np.concatenate([scan.probability for scan in drive.scans if len(scan)])
    middle = float(np.median(given))
    expected = "that it is a pole, from 0 to 1"
    if middle > 1.0 or middle < 0.0:
        return [
            Finding(
                "pole_probability", "error", drive.names.poles,
                f"probability is {middle:.3g} in the median", expected,
                "write 0.9 for 90 percent, or leave the column out",
            )
        ]  # fmt: skip
    if middle >= _PROBABILITY_DOUBT:
        return []
    return [
        Finding(
            "pole_probability", "error" if middle < _PROBABILITY_WRONG else "warning",
            drive.names.poles,
            f"probability is {middle:.3g} in the median: its poles are taken for false detections, "
            "and match nothing", expected,
            "write 1 minus it if it is that of a false detection, or leave the column out",
        )
    ]  # fmt: skip


def duplicate_findings(drive: Drive) -> list[Finding]:
    """Stamps that stand twice because they were rounded."""
    found = []
    for name, stream in (
        ("odometry", drive.odometry),
        ("gnss", drive.gnss),
        ("reference", drive.reference),
    ):
        lost = drive.problems.get(f"{name}_duplicate_stamps", 0)
        if stream is None or not lost or lost < _DUPLICATES_MAX * (len(stream) + lost):
            continue
        found.append(
            Finding(
                "stamp_rounding", "warning", getattr(drive.names, name),
                f"{lost} of {lost + len(stream)} rows repeat the stamp before (left out)",
                "one row a stamp", "write the stamps with more decimals",
            )
        )  # fmt: skip
    return found
