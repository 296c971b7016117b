"""When the pictures were taken: how the camera turns in a bend, against the odometry.

Its turn from pair to pair is that of the points in space: along with the car's way, near things
swing too, by more than a lag of a fifth of a second does.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import PolemapError
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.camera_check import StereoMatches, fit_step, match_next
from polemap.drivelog.plausibility.features import Grey, match_pair, to_8_bit
from polemap.drivelog.plausibility.odometer import Odometer, of_odometry, of_reference
from polemap.drivelog.samples import Image
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

_FRAMES = 30
_FEATURES, _FEATURES_MIN = 120, 20
# wider pictures are halved: a turn needs no more
_WIDE_PX = 800
_LAG_MAX_S, _STEP_S = 1.0, 0.02
_TURN_SD_RADPS = 0.02
_EXPLAINED_MIN = 0.85
_GAIN_RANGE = (0.7, 1.4)
_REST_FLOOR = 0.0002
_BESIDE, _SHARPER = 10, 2.5
_LAG_DOUBT_S, _LAG_WRONG_S = 0.12, 0.6


def stamp_findings(drive: Drive) -> list[Finding]:
    """Stamps of the pictures against the odometry, from the stretch that turns most variedly."""
    rig = drive.rig
    if drive.odometry is not None and len(drive.odometry) > 10:
        motion = of_odometry(drive.odometry, drive.names.odometry)
    elif drive.reference is not None and len(drive.reference) > 10:
        motion = of_reference(drive.reference, drive.names.reference)
    else:
        return []
    first = _liveliest(drive.frame_stamps_s, motion)
    if first is None or rig is None:
        return []
    rows = np.arange(first, first + _FRAMES)
    try:
        turned = _turned(drive, rig, rows)
    except PolemapError:
        return []
    stamps = drive.frame_stamps_s[rows]
    seen = turned / np.diff(stamps)
    lags = np.arange(-_LAG_MAX_S, _LAG_MAX_S + 1e-9, _STEP_S)
    share = np.array([_explained(seen, _turns(motion, stamps + lag)) for lag in lags])
    if not np.isfinite(share).any():
        return []
    # on a winding road the other sign fits half a period away: it needs to be the better one
    best = int(np.nanargmax(np.where(share < 0.0, -0.9 * share, share)))
    now = share[np.argmin(np.abs(lags))]
    if abs(share[best]) < _EXPLAINED_MIN or not np.isfinite(now):
        return []
    if share[best] < 0.0 and abs(now) > _EXPLAINED_MIN:
        return [
            Finding(
                "picture_mirrored", "error", drive.names.frames,
                f"they swing against {motion.name} ({100 * abs(now):.0f} % explained)",
                "the same sense", "check the sign of the yaw rate, or for mirrored pictures",
            )
        ]  # fmt: skip
    # the peak must be sharp, and no lag clearly off it: a bend that merely tightens has none
    unexplained = 1.0 - share + _REST_FLOOR
    beside = [unexplained[best + k] for k in (-_BESIDE, _BESIDE) if 0 <= best + k < len(lags)]
    sharp = float(np.nanmin(beside)) / unexplained[best]
    better = (1.0 - now + _REST_FLOOR) / unexplained[best]
    lag = float(lags[best])
    if share[best] < 0.0 or min(sharp, better) < _SHARPER or abs(lag) < _LAG_DOUBT_S:
        return []
    late = lag < 0.0
    return [
        Finding(
            "clock_offset", "error" if abs(lag) > _LAG_WRONG_S else "warning", drive.names.frames,
            f"the pictures swing {abs(lag):.2f} s {'after' if late else 'before'} {motion.name} "
            f"turns ({100 * share[best]:.0f} % explained)", f"within {_LAG_DOUBT_S:g} s",
            f"{'subtract' if late else 'add'} {abs(lag):.2f} s {'from' if late else 'to'} the "
            f"stamps of {drive.names.frames}",
        )
    ]  # fmt: skip


def _liveliest(stamps: Floats, motion: Odometer) -> int | None:
    """First row of the stretch whose turn rate varies most; None if none does enough."""
    if len(stamps) < _FRAMES:
        return None
    step = np.diff(stamps)
    rate = _turns(motion, stamps)
    known = np.isfinite(rate) & (step < 0.5)
    window = np.lib.stride_tricks.sliding_window_view(np.where(known, rate, 0.0), _FRAMES - 1)
    whole = np.lib.stride_tricks.sliding_window_view(known, _FRAMES - 1).all(axis=1)
    spread = np.where(whole, window.std(axis=1), 0.0)
    best = int(np.argmax(spread))
    return best if spread[best] > _TURN_SD_RADPS else None


def _turns(motion: Odometer, stamps: Floats) -> Floats:
    _, turn, known = motion.spans(stamps[:-1], stamps[1:])
    return np.where(known, turn / np.diff(stamps), np.nan)


def _turned(drive: Drive, rig: StereoRig, rows: NDArray[np.int_]) -> Floats:
    """By how much the camera turns to the left from each frame to the next, rad, `(n - 1,)`."""
    if drive.images is None:
        return np.full(len(rows) - 1, np.nan)
    in_vehicle = rig.vehicle_from_camera.rotation()
    scale = 0.5 if rig.width_px > _WIDE_PX else 1.0
    before: tuple[Grey, Grey] | None = None
    turned = []
    for row in rows:
        left, right = (_small(side, scale) for side in drive.images.load(int(row)))
        if before is not None:
            pair = match_pair(*before, _FEATURES)
            seen = match_next(before[0], pair.places_px, pair.steps_px, left, right)
            turned.append(_turn_of(rig, seen, scale, in_vehicle))
        before = left, right
    return np.array(turned)


def _small(image: Image, scale: float) -> Grey:
    grey = to_8_bit(image)
    if scale == 1.0:
        return grey
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


def _turn_of(rig: StereoRig, seen: StereoMatches, scale: float, in_vehicle: Floats) -> float:
    if len(seen.first_px) < _FEATURES_MIN:
        return float("nan")
    whole = StereoMatches(
        seen.first_px / scale,
        seen.first_disparity_px / scale,
        seen.second_px / scale,
        seen.second_disparity_px / scale,
    )
    try:
        next_from_first, _ = fit_step(rig, whole)
    except np.linalg.LinAlgError:
        return float("nan")
    turn = in_vehicle @ next_from_first[:3, :3].T @ in_vehicle.T
    return float(np.arctan2(turn[1, 0], turn[0, 0]))


def _explained(seen: Floats, told: Floats) -> float:
    """Share of the turns seen that those told explain, negative if they do with the other sign.

    Through the origin and with a gain near one: on a bend that only tightens any lag would do
    otherwise.
    """
    both = np.isfinite(seen) & np.isfinite(told)
    if both.sum() < 0.7 * len(seen):
        return float("nan")
    a, b = seen[both], told[both]
    power = float(b @ b)
    if power <= 0.0 or not a.any():
        return float("nan")
    gain = float(a @ b) / power
    sign = -1.0 if gain < 0.0 else 1.0
    rest = a - sign * np.clip(abs(gain), *_GAIN_RANGE) * b
    return sign * max(1.0 - float(rest @ rest) / float(a @ a), 0.0)
