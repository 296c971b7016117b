"""Pictures: whether a pair is a pair, by features followed from left to right in a few frames.

In a rectified pair the same thing stands in the same row and, in the right picture, not to the
right of where it stands in the left one. Features are followed with vertical freedom, so that both
can be seen to fail.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import PolemapError
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.camera_check import (
    SeenMotion,
    camera_findings,
    match_next,
    moving_rows,
    see_motion,
)
from polemap.drivelog.plausibility.features import (
    IN_ROW_PX,
    PairMatch,
    match_pair,
    to_8_bit,
)
from polemap.drivelog.plausibility.picture_motion import stamp_findings
from polemap.drivelog.samples import Image

Floats = NDArray[np.float64]

_FRAMES = 4
# KITTI and simulated pairs: rows within 0.6 px, 89 % or more of the features within 1 px of that
_ROWS_DOUBT_PX, _ROWS_WRONG_PX = 1.1, 1.8
_IN_ROW_SHARE = 0.65
_LEAST_FEATURES = 25
_EXPOSURE = 1.8
_DARK_SD = 4.0


def check_pictures(drive: Drive) -> list[Finding]:
    """What in the stereo pairs of a drive cannot be right, from a few of them."""
    if not drive.has_frames or drive.images is None:
        return []
    count = len(drive.frame_stamps_s)
    # where the car moves, so that the next pair shows how; neither the first nor the last: a
    # recorder's ends are the least like the rest
    moving = moving_rows(drive)
    choice = moving if len(moving) >= _FRAMES else np.arange(count)
    rows = choice[np.unique(np.linspace(0, len(choice) - 1, _FRAMES + 2).astype(int)[1:-1])]
    try:
        pairs = [drive.images.load(int(row)) for row in rows]
    except PolemapError as error:
        # the drive is named already: its path would crowd out what is wrong
        value = str(error).removeprefix(f"{drive.path}/")
        return [
            Finding(
                "picture", "error", drive.names.frames, value, "pictures of the drive's camera",
                "rectify them with this calibration, or restore the file",
            )
        ]  # fmt: skip
    found = _light(drive.names.frames, pairs)
    if any(finding.severity == "error" for finding in found):
        return found
    matches = [match_pair(left, right) for left, right in pairs]
    seen = [match for match in matches if len(match.places_px) >= _LEAST_FEATURES]
    if len(seen) < 0.5 * len(matches):
        few = int(np.median([len(match.places_px) for match in matches]))
        found.append(
            Finding(
                "picture_match", "warning", drive.names.frames,
                f"{few} features in the median are found in both pictures of a pair",
                f"{_LEAST_FEATURES} or more", "check focus, exposure and that the pairs belong "
                "together",
            )
        )  # fmt: skip
        return found
    wrong = _order(drive.names.frames, seen) or _rows(drive, rows, matches)
    if not wrong and choice is moving:
        wrong = camera_findings(drive, _motions(drive, rows, pairs, matches))
    return found + wrong + ([] if _of_pairs(drive.names.frames, wrong) else stamp_findings(drive))


def _of_pairs(name: str, found: list[Finding]) -> bool:
    return any(finding.stream == name for finding in found)


def _motions(
    drive: Drive, rows: NDArray[np.int_], pairs: list[tuple[Image, Image]], matches: list[PairMatch]
) -> list[SeenMotion]:
    """How the camera moves from each of the rows to the next."""
    seen = []
    for row, (left, _), match in zip(rows, pairs, matches, strict=True):
        if drive.images is None or len(match.places_px) < _LEAST_FEATURES:
            continue
        try:
            later = [to_8_bit(side) for side in drive.images.load(int(row) + 1)]
        except PolemapError:
            continue
        next_px = match_next(to_8_bit(left), match.places_px, match.steps_px, *later)
        one = see_motion(drive, int(row), next_px)
        if one is not None:
            seen.append(one)
    return seen


def _light(name: str, pairs: list[tuple[Image, Image]]) -> list[Finding]:
    """Exposure, a covered camera, the same picture twice."""
    if all(np.array_equal(left, right) for left, right in pairs):
        return [
            Finding(
                "picture_same", "error", name, "left and right picture are the same",
                "two cameras", "name the right camera's pictures as the right ones",
            )
        ]  # fmt: skip
    depth = 257.0 if pairs[0][0].dtype == np.uint16 else 1.0
    means = np.array([[side.mean() / depth for side in pair] for pair in pairs])
    spreads = np.array([[side.std() / depth for side in pair] for pair in pairs])
    left, right = np.median(spreads, axis=0)
    if min(left, right) < _DARK_SD and max(left, right) > 4.0 * min(left, right):
        side = "left" if left < right else "right"
        return [
            Finding(
                "picture_covered", "error", name,
                f"the {side} picture is uniform (sd {min(left, right):.1f} of 255 grey values, the "
                f"other {max(left, right):.1f})", "two pictures of the same scene",
                f"uncover or replace the {side} camera",
            )
        ]  # fmt: skip
    ratio = float(np.median((means[:, 0] + 1.0) / (means[:, 1] + 1.0)))
    if not 1.0 / _EXPOSURE < ratio < _EXPOSURE:
        return [
            Finding(
                "picture_exposure", "warning", name,
                f"the left picture is {ratio:.2f} times as bright as the right one",
                f"a ratio below {_EXPOSURE:g}", "couple the exposure of the cameras",
            )
        ]  # fmt: skip
    return []


def _order(name: str, matches: list[PairMatch]) -> list[Finding]:
    share = float(np.median([match.to_the_right for match in matches]))
    if share < 0.6:
        return []
    return [
        Finding(
            "picture_order", "error", name,
            f"{100 * share:.0f} % of the features stand farther right in the right picture",
            "farther left: disparities are positive",
            "exchange left and right",
        )
    ]  # fmt: skip


def _rows(drive: Drive, rows: NDArray[np.int_], matches: list[PairMatch]) -> list[Finding]:
    seen = [match for match in matches if len(match.places_px) >= _LEAST_FEATURES]
    scattered = [match for match in seen if match.in_row < _IN_ROW_SHARE]
    if len(scattered) >= max(1.0, 0.5 * len(seen)):
        return _scattered(drive, rows, matches, scattered)
    row = float(np.median([match.row_px for match in seen]))
    if abs(row) < _ROWS_DOUBT_PX:
        return []
    return [
        Finding(
            "picture_rows", "error" if abs(row) > _ROWS_WRONG_PX else "warning", drive.names.frames,
            f"the right picture stands {abs(row):.1f} px {'lower' if row > 0 else 'higher'}",
            f"the same rows within {_ROWS_DOUBT_PX:g} px", "rectify the pictures again",
        )
    ]  # fmt: skip


def _scattered(
    drive: Drive, rows: NDArray[np.int_], matches: list[PairMatch], scattered: list[PairMatch]
) -> list[Finding]:
    """Rows that do not agree within a picture: not rectified, or two different instants."""
    share = float(np.median([match.in_row for match in scattered]))
    value = f"{100 * share:.0f} % of the features keep their row (within {IN_ROW_PX:g} px)"
    expected = f"{100 * _IN_ROW_SHARE:.0f} % or more"
    slopes = [_slope(match) for match in scattered]
    if np.median([fit for fit, _ in slopes]) > 0.85:
        across = float(np.median([size for _, size in slopes]))
        return [
            Finding(
                "picture_rectified", "error", drive.names.frames,
                f"{value}; the rows drift by {across:.1f} px over the picture", expected,
                "rectify the pictures with the calibration of this rig",
            )
        ]  # fmt: skip
    # by identity: arrays of two matches cannot be compared
    first = next(k for k, match in enumerate(matches) if match is scattered[0])
    other = _other_instant(drive, int(rows[first]), scattered[0])
    text = f"; {other}" if other else ""
    return [
        Finding(
            "picture_instant", "error", drive.names.frames,
            value + (text or "; they do not show the same instant"), expected,
            "pair pictures that were taken at the same time",
        )
    ]  # fmt: skip


def _slope(match: PairMatch) -> tuple[float, float]:
    """Share of features that a plane of rows explains, and its change over the picture, px."""
    places = match.places_px
    design = np.column_stack([np.ones(len(places)), places])
    weight: Floats = np.ones(len(places))
    fit: Floats = np.zeros(3)
    rest: Floats = np.zeros(len(places))
    for _ in range(5):
        target = match.steps_px[:, 1] * weight
        fit = np.asarray(np.linalg.lstsq(design * weight[:, None], target, rcond=None)[0])
        rest = np.abs(match.steps_px[:, 1] - design @ fit)
        scale = 2.0 * float(np.median(rest)) + 1e-3
        weight = np.asarray(1.0 / np.sqrt(1.0 + (rest / scale) ** 2))
    size = float(np.abs(fit[1:]) @ np.ptp(places, axis=0))
    return float(np.mean(rest < IN_ROW_PX)), size


def _other_instant(drive: Drive, row: int, now: PairMatch) -> str | None:
    """Which neighbouring right picture fits the left one, in words."""
    if drive.images is None:
        return None
    for step, text in ((-1, "after"), (1, "before"), (-2, "after"), (2, "before")):
        if not 0 <= row + step < len(drive.frame_stamps_s):
            continue
        try:
            left, _ = drive.images.load(row)
            _, right = drive.images.load(row + step)
        except PolemapError:
            return None
        match = match_pair(left, right)
        if len(match.places_px) >= _LEAST_FEATURES and match.in_row > now.in_row + 0.25:
            frames = "the frame" if abs(step) == 1 else f"{abs(step)} frames"
            return f"the right picture is of {frames} {text}"
    return None
