"""When the pictures were taken: how they swing in a bend, against the turns of the odometry."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import PolemapError
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.features import follow, to_8_bit
from polemap.drivelog.plausibility.odometer import Odometer, of_odometry, of_reference
from polemap.drivelog.samples import Image

Floats = NDArray[np.float64]

_FRAMES = 30
_FEATURES = 60
_LAG_MAX_S, _STEP_S = 1.0, 0.02
_TURN_SD_RADPS = 0.03
_EXPLAINED_MIN = 0.85
_GAIN_RANGE = (0.7, 1.4)
_REST_FLOOR = 0.001
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
        swing = _swings(drive, rows)
    except PolemapError:
        return []
    stamps = drive.frame_stamps_s[rows]
    seen = swing / rig.focal_px / np.diff(stamps)
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


def _swings(drive: Drive, rows: NDArray[np.int_]) -> Floats:
    """Columns by which the scene moves to the right from each frame to the next, `(n - 1,)`."""
    if drive.images is None:
        return np.full(len(rows) - 1, np.nan)
    before = None
    swings = []
    for row in rows:
        left, _ = drive.images.load(int(row))
        small = cv2.resize(left, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        grey = to_8_bit(cast(Image, small))
        if before is not None:
            # the far scene: the upper part, near the horizon and above, moves by the turn alone
            top = before[: int(0.55 * before.shape[0])]
            corners = cv2.goodFeaturesToTrack(top, _FEATURES, 0.01, 6)
            steps = np.empty((0, 2))
            if corners is not None:
                _, steps = follow(before, grey, np.asarray(corners, dtype=np.float32))
            swings.append(2.0 * float(np.median(steps[:, 0])) if len(steps) > 8 else np.nan)
        before = grey
    return np.array(swings)


def _explained(seen: Floats, told: Floats) -> float:
    """Share of the swing that the turns explain, negative where they do so with the other sign.

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
