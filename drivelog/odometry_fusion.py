"""Wheels and camera as one odometry: each corrects the other, and finds its slips.

Over every step of the camera the wheels' mean speed is `s v` and their yaw rate `w + b`, where `v`
and `w` are the camera's. A Kalman filter follows `s` and `b`. The wheels fill in between the
pictures, divided by what of `s` is theirs; where a step contradicts the camera by more than both
can err (a wheel that slips, locks, spins or reads zero), the camera's step stands in its place, and
where the camera knows nothing the wheels go on alone. The camera is the one that is wrong where its
speed, and not that of the wheels, jumped as no car's does since both last agreed (a bus that fills
the view): then it counts for nothing until they agree again.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.camera_motion import CameraTrack
from polemap.drivelog.streams import OdometryStream

Floats = NDArray[np.float64]

# tyres wear and heat by percents; of a calibrated camera, its offset learned, half a percent is
# left: most of the ratio is the wheels'
_WHEEL_SCALE_SD, _CAMERA_SCALE_SD = 0.02, 0.005
_YAW_OFFSET_SD_RADPS = 0.02
_SCALE_WALK, _YAW_OFFSET_WALK_RADPS = 2e-4, 1e-5
# noise of wheel samples averaged over a step: a cogwheel's edge and a slip angle's share of yaw
_SPEED_SD_MPS, _SPEED_SHARE_SD = 0.05, 0.01
_YAW_SD_RADPS, _YAW_SHARE_SD = 0.004, 0.03
_GATE = 4.0
# between pictures no car changes by more than this acceleration, and noise
_ACCELERATION_MAX_MPS2, _JUMP_FREE_MPS = 10.0, 0.5
# wheels report every 10 to 50 ms: longer is a hole
_HOLE_S = 0.2


@dataclass(frozen=True, slots=True)
class FusedOdometry:
    """The stream, and what was found.

    Attributes:
        stream: odometry of wheels and camera.
        wheel_scale: speed of the wheels over the true one, at the end.
        yaw_offset_radps: of the wheels' or gyro's yaw rate, at the end.
        replaced: camera steps that stand in the place of the wheels' samples.
        filled: camera steps where the wheels have a hole.
        refused: camera steps that the wheels show to be wrong.
    """

    stream: OdometryStream
    wheel_scale: float
    yaw_offset_radps: float
    replaced: int
    filled: int
    refused: int


def fuse_odometry(wheels: OdometryStream, camera: CameraTrack) -> FusedOdometry:
    """One odometry of both; samples of a replaced step arrive when its second picture does."""
    steps = camera.planar
    later = np.searchsorted(camera.stamp_s, steps.stamp_s)
    begins, ends = camera.stamp_s[later - 1], camera.stamp_s[later]
    first = np.searchsorted(wheels.stamp_s, begins, side="left")
    last = np.searchsorted(wheels.stamp_s, ends, side="right")
    before = np.searchsorted(wheels.stamp_s, ends, side="left")
    speed, yaw_rate = np.array(wheels.speed_mps), np.array(wheels.yaw_rate_radps)
    arrival = np.array(wheels.arrival_s)
    # what the camera sees of the speed aside goes with the first sample after its picture
    lateral = np.full(len(speed), np.nan)
    heard = np.searchsorted(wheels.arrival_s, steps.arrival_s)
    in_time = heard < len(speed)
    lateral[heard[in_time]] = steps.lateral_mps[in_time]
    of_scale = _WHEEL_SCALE_SD**2 / (_WHEEL_SCALE_SD**2 + _CAMERA_SCALE_SD**2)
    scale, offset = 1.0, 0.0
    scale_var = _WHEEL_SCALE_SD**2 + _CAMERA_SCALE_SD**2
    offset_var = _YAW_OFFSET_SD_RADPS**2
    corrected_to = 0
    replaced, filling, refused = 0, [], 0
    agreed: tuple[float, float, float] | None = None
    camera_wrong = False
    for row in range(len(steps)):
        low, high = int(first[row]), int(last[row])
        # causal: what arrived before this picture was corrected by what was known then
        upto = int(before[row])
        _correct(speed, yaw_rate, slice(corrected_to, upto), scale**of_scale, offset)
        seen = wheels.stamp_s[low:high]
        holes = len(seen) < 2 or max(seen[0] - begins[row], ends[row] - seen[-1]) > _HOLE_S
        corrected_to = max(corrected_to, upto)
        if holes or np.diff(seen).max() > _HOLE_S:
            filling.append(row)
            continue
        told = float(wheels.speed_mps[low:high].mean())
        told_yaw = float(wheels.yaw_rate_radps[low:high].mean())
        v, w = float(steps.speed_mps[row]), float(steps.yaw_rate_radps[row])
        noise = steps.speed_sd_mps[row] ** 2 + _SPEED_SD_MPS**2 + (_SPEED_SHARE_SD * v) ** 2
        noise_yaw = steps.yaw_rate_sd_radps[row] ** 2 + _YAW_SD_RADPS**2 + (_YAW_SHARE_SD * w) ** 2
        scale_var += _SCALE_WALK**2
        offset_var += _YAW_OFFSET_WALK_RADPS**2
        wrong = told - scale * v, told_yaw - offset - w
        spread = v * v * scale_var + noise, offset_var + noise_yaw
        if abs(wrong[0]) > _GATE * sqrt(spread[0]) or abs(wrong[1]) > _GATE * sqrt(spread[1]):
            if agreed is not None:
                # who jumped is told by the first step that differs; later ones follow it
                waited_s = float(steps.stamp_s[row]) - agreed[0]
                camera_wrong = _jumps(v - agreed[1], waited_s) and not _jumps(
                    (told - agreed[2]) / scale, waited_s
                )
                agreed = None
            if camera_wrong:
                refused += 1
                continue
            speed[low:upto], yaw_rate[low:upto] = v * scale ** (1.0 - of_scale), w
            arrival[low:upto] = np.maximum(arrival[low:upto], steps.arrival_s[row])
            replaced += 1
            continue
        agreed, camera_wrong = (float(steps.stamp_s[row]), v, told), False
        scale += scale_var * v / spread[0] * wrong[0]
        scale_var *= noise / spread[0]
        offset += offset_var / spread[1] * wrong[1]
        offset_var *= noise_yaw / spread[1]
    _correct(speed, yaw_rate, slice(corrected_to, None), scale**of_scale, offset)
    rows = np.array(filling, dtype=np.int64)
    stamps = np.concatenate([wheels.stamp_s, steps.stamp_s[rows]])
    # a sample of the wheels at the very stamp of a step stays
    _, keep = np.unique(stamps, return_index=True)
    stream = OdometryStream(
        stamps[keep],
        np.concatenate([arrival, steps.arrival_s[rows]])[keep],
        np.concatenate([speed, steps.speed_mps[rows]])[keep],
        np.concatenate([yaw_rate, steps.yaw_rate_radps[rows]])[keep],
        np.concatenate([lateral, steps.lateral_mps[rows]])[keep],
    )
    return FusedOdometry(stream, scale**of_scale, offset, replaced, len(rows), refused)


def _jumps(change_mps: float, seconds: float) -> bool:
    return abs(change_mps) > _JUMP_FREE_MPS + _ACCELERATION_MAX_MPS2 * seconds


def _correct(speed: Floats, yaw_rate: Floats, rows: slice, scale: float, offset: float) -> None:
    speed[rows] /= scale
    yaw_rate[rows] -= offset
