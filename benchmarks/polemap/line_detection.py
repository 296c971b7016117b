"""Markings and kerbs that are seen: how many, how alike from frame to frame, how true.

    python -m benchmarks.polemap.line_detection [SEEDS] [FRAMES] [WORLD ...]

Recordings: pieces a frame, and the consistency of pieces of one line that were seen half a second
apart, in the earth frame of the drive's poses: squared difference across over the stated variances
of both (NEES, 1 where they are right), of directions alike. Errors that last longer than that do
not show there. Simulated streets have truth: precision (a line of the kind within 0.3 m and 0.1
rad), recall by metres of lines within 6 to 18 m of the camera and in its picture (what a car hides
counts as missed), and errors against the stated deviations. Time is the processor's, of lines
alone, the median over frames. Not timed against anything, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

import polemap.detect.detection as detection
from benchmarks.harness import RECORDINGS
from benchmarks.simulate.streets import Street, open_street
from polemap.config import PolemapConfig
from polemap.detect.config import DetectionConfig
from polemap.detect.lines.find import find_lines
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.line_detections import LineDetections
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import StereoFrame
from polemap.perception import PolePerception, perceive_drive
from polemap.simulate.ground import kerb_m, marking_lines
from polemap.vehicle.pose import inverse_transform_points, rotate_back, transform_points, wrap_angle

Floats = NDArray[np.float64]
Row = tuple[float, float, float, float, float]  # range, off, its sd, turned, its sd

KINDS = (LandmarkKind.LANE_MARKING, LandmarkKind.KERB)
DRIVES = {
    "KITTI 03": "kitti_odometry/sequences/03",
    "KITTI 00": "kitti_odometry/sequences/00",
    "KITTI raw 0039": "kitti_raw/2011_09_26/2011_09_26_drive_0039_sync",
}
WORLDS = ("country_road", "avenue", "suburb", "boulevard")
FIRST_SEED = 720
APART_FRAMES = 5
BANDS_M = ((4.0, 10.0), (10.0, 15.0), (15.0, 26.0))
SHOWN_M = (6.0, 18.0)  # ahead of the rear axle
RIGHT_M, RIGHT_RAD = 0.3, 0.1
LOW_M = 0.05  # a lower kerb may be found, but need not
_STEP_M = 0.5


@dataclass
class Result:
    """Of one drive or world."""

    frames: int = 0
    pieces: dict[LandmarkKind, int] = field(default_factory=lambda: defaultdict(int))
    right: dict[LandmarkKind, int] = field(default_factory=lambda: defaultdict(int))
    shown: dict[LandmarkKind, list[bool]] = field(default_factory=lambda: defaultdict(list))
    rows: dict[LandmarkKind, list[Row]] = field(default_factory=lambda: defaultdict(list))
    seconds: list[float] = field(default_factory=list)

    def count(self, lines: LineDetections | None) -> None:
        self.frames += 1
        for kind in [] if lines is None else lines.kind.tolist():
            self.pieces[LandmarkKind(kind)] += 1


def settings() -> PolemapConfig:
    """Poles and lines."""
    return PolemapConfig(detection=DetectionConfig(kinds=("pole", "lane_marking", "kerb")))


def recorded(path: str) -> Result:
    """A recording against itself."""
    drive = open_drive(RECORDINGS / path)
    assert drive.rig is not None
    assert drive.reference is not None
    result = Result()
    seen: list[tuple[Floats, LineDetections]] = []
    for perceived in perceive_drive(drive, PolePerception(drive.rig, settings())):
        lines = perceived.view.lines
        result.count(lines)
        pose = drive.reference.at(np.array([perceived.frame.stamp_s]))[0]
        seen.append((pose, LineDetections.none() if lines is None else lines))
    for (pose, now), (earlier_pose, earlier) in zip(
        seen[APART_FRAMES:], seen[:-APART_FRAMES], strict=True
    ):
        _pairs(result, pose, now, earlier_pose, earlier)
    return result


def _pairs(
    result: Result, pose: Floats, now: LineDetections, earlier_pose: Floats, earlier: LineDetections
) -> None:
    """Compare pieces of one line where both were seen."""
    ends = [
        inverse_transform_points(pose, transform_points(earlier_pose, end))
        for end in (earlier.start_vehicle_m, earlier.end_vehicle_m)
    ]
    before = earlier.with_columns(start_vehicle_m=ends[0], end_vehicle_m=ends[1])
    for row in range(len(now)):
        along = np.array([np.cos(now.direction_rad[row]), np.sin(now.direction_rad[row])])
        normal = np.array([-along[1], along[0]])
        middle = now.middle_vehicle_m[row]
        for other in np.flatnonzero(before.kind == now.kind[row]).tolist():
            a, b = (((end[other] - middle) @ along) for end in ends)
            half = 0.5 * now.length_m[row]
            low, high = max(min(a, b), -half), min(max(a, b), half)
            turned = _turned(before.direction_rad[other] - now.direction_rad[row])
            if high - low < 0.5 or abs(turned) > 0.2:
                continue
            at = 0.5 * (low + high)
            off = float((before.middle_vehicle_m[other] - middle) @ normal)
            off += float(np.tan(turned)) * (at - 0.5 * (a + b))
            if abs(off) > 0.6:
                continue
            sd = _sd_at(now, row, at), _sd_at(before, other, at - 0.5 * (a + b))
            turn_sd = np.hypot(now.direction_sd_rad[row], before.direction_sd_rad[other])
            result.rows[LandmarkKind(now.kind[row])].append(
                (float(np.hypot(*middle)), off, float(np.hypot(*sd)), turned, float(turn_sd))
            )


def _sd_at(lines: LineDetections, row: int, from_middle_m: float) -> float:
    return float(np.hypot(lines.offset_sd_m[row], lines.direction_sd_rad[row] * from_middle_m))


def _turned(angle_rad: float) -> float:
    """Between lines: they have no sense."""
    return float(wrap_angle(2.0 * angle_rad)) / 2.0


def simulated(world: str, seed: int, frames: int, result: Result) -> None:
    """A stretch of a street against its truth; adds to the result."""
    street = open_street(world, seed, 10.0)
    rig = street.studio.renderer.rig
    perception = PolePerception(rig, settings())
    stamps = street.plan.frame_stamps_s
    first = int(np.searchsorted(stamps, 6.0))
    taken = 0
    for number in range(first, min(first + 2 * frames, len(stamps)), 2):
        stamp = float(stamps[number])
        while taken < len(street.odometry) and street.odometry.stamp_s[taken] <= stamp:
            perception.record_odometry(street.odometry.sample(taken))
            taken += 1
        shot = street.studio.shot(number)
        lines = perception.perceive(
            StereoFrame(stamp, stamp, number, shot.left.copy(), shot.right.copy())
        ).view.lines
        result.count(lines)
        lines = LineDetections.none() if lines is None else lines
        truth = true_lines(street, stamp)
        _judge(result, lines, truth)
        low = street.world.scenario.section.kerb_height_m < LOW_M
        for kind, points in truth:
            if kind == LandmarkKind.KERB and low:
                continue
            u, v, _ = rig.project(np.column_stack([points, np.zeros(len(points))])).T
            shown = (u > 5) & (u < rig.width_px - 5) & (v < rig.height_px - 5)
            shown &= (points[:, 0] > SHOWN_M[0]) & (points[:, 0] < SHOWN_M[1])
            mine = lines.take(lines.kind == kind)
            result.shown[kind] += [_covered(mine, point) for point in points[shown]]


def true_lines(street: Street, stamp_s: float) -> list[tuple[LandmarkKind, Floats]]:
    """Lines of the street near the car `(n, 2)`, a point every half metre, vehicle frame."""
    spec, route = street.world.scenario.section, street.world.route
    pose = street.plan.motion.at(np.array([stamp_s]))[0]
    station = float(street.plan.motion.value("station_m", np.array([stamp_s]))[0])
    along = np.arange(np.floor(station / _STEP_M) * _STEP_M, station + 30.0, _STEP_M)
    edges = [spec.road_half_width_m - 0.375] if spec.edge_line else []
    lines = []
    for lateral in marking_lines(spec):
        solid = abs(lateral) in edges or (lateral == 0.0 and spec.centre_line == "solid")
        painted = along if solid else along[along % 9.0 < 3.0]
        lines.append((LandmarkKind.LANE_MARKING, painted, lateral))
    sides = [kerb_m(spec) + 0.02, -kerb_m(spec) - 0.02]
    if spec.median_width_m > 0:
        sides += [0.5 * spec.median_width_m, -0.5 * spec.median_width_m]
    lines += [(LandmarkKind.KERB, along, side) for side in sides]
    return [
        (kind, inverse_transform_points(pose, route.at(stations, lateral)[:, :2]))
        for kind, stations, lateral in lines
    ]


def _covered(lines: LineDetections, point: Floats) -> bool:
    along, across = rotate_back(point - lines.middle_vehicle_m, lines.direction_rad).T
    near = (np.abs(along) <= 0.5 * lines.length_m + 0.3) & (np.abs(across) < RIGHT_M)
    return bool(near.any())


def _judge(result: Result, lines: LineDetections, truth: list[tuple[LandmarkKind, Floats]]) -> None:
    for row in range(len(lines)):
        kind = LandmarkKind(lines.kind[row])
        middle = lines.middle_vehicle_m[row]
        best: Row | None = None
        for points in [points for one, points in truth if one == kind and len(points) > 2]:
            near = int(np.clip(np.argmin(np.hypot(*(points - middle).T)), 1, len(points) - 2))
            step = points[near + 1] - points[near - 1]
            direction = float(np.arctan2(step[1], step[0]))
            normal = np.array([-np.sin(direction), np.cos(direction)])
            off = float((middle - points[near]) @ normal)
            turned = _turned(float(lines.direction_rad[row]) - direction)
            # a dash that ends where the piece goes on has its line, too
            apart = float(np.hypot(*(points[near] - middle)))
            if apart > 2.0 or abs(off) > RIGHT_M or abs(turned) > RIGHT_RAD:
                continue
            if best is None or abs(off) < abs(best[1]):
                best = (
                    float(np.hypot(*middle)), off, float(lines.offset_sd_m[row]), turned,
                    float(lines.direction_sd_rad[row]),
                )  # fmt: skip
        if best is not None:
            result.right[kind] += 1
            result.rows[kind].append(best)


def _tell(name: str, result: Result, *, truth: bool) -> None:
    for kind in KINDS:
        rows = np.array(result.rows[kind]).reshape(-1, 5)
        n = result.pieces[kind]
        told = f"{name} | {kind.name.lower()} | {n / max(result.frames, 1):.2f} a frame ({n})"
        if truth:
            shown = result.shown[kind]
            told += f" | precision {result.right[kind] / max(n, 1):.2f}"
            told += f" | recall {np.mean(shown) if shown else np.nan:.2f} of {len(shown)}"
        print(f"{told} | {_figures(rows)}")
        for low, high in BANDS_M:
            part = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
            if len(part):
                print(f"    {low:.0f} to {high:.0f} m: {_figures(part)}")
    if result.seconds:
        print(f"    lines alone: {1e3 * float(np.median(result.seconds)):.2f} ms a frame")


def _figures(rows: Floats) -> str:
    if not len(rows):
        return "no pairs"
    off, turned = rows[:, 1], rows[:, 3]
    nees = np.mean((off / rows[:, 2]) ** 2), np.mean((turned / rows[:, 4]) ** 2)
    median = np.median((off / rows[:, 2]) ** 2) / 0.455
    return (
        f"n {len(rows)}, off {np.sqrt(np.mean(off**2)):.3f} m (bias {off.mean():+.3f}), NEES "
        f"{nees[0]:.2f} (by median {median:.2f}); direction "
        f"{np.sqrt(np.mean(turned**2)):.4f} rad, NEES {nees[1]:.2f}"
    )


def main(words: list[str]) -> None:
    """Print a row a drive or world and kind."""
    seeds = int(words[0]) if words else 3
    frames = int(words[1]) if len(words) > 1 else 20
    cv2.setNumThreads(1)
    seconds: list[float] = []
    plain = find_lines

    def timed(*arguments: object) -> LineDetections | None:
        begin = time.process_time()
        lines = plain(*arguments)  # type: ignore[arg-type]
        seconds.append(time.process_time() - begin)
        return lines

    setattr(detection, "find_lines", timed)  # noqa: B010
    for name, path in DRIVES.items() if len(words) < 3 else ():
        if (RECORDINGS / path).exists():
            seconds.clear()
            result = recorded(path)
            result.seconds = list(seconds)
            _tell(name, result, truth=False)
    for world in words[2:] or WORLDS:
        seconds.clear()
        result = Result()
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            simulated(world, seed, frames, result)
        result.seconds = list(seconds)
        _tell(world, result, truth=True)


if __name__ == "__main__":
    main(sys.argv[1:])
