"""A town of poles and cars that look at it: scans with known truth, without images.

The detector errs like a stereo camera: along the ray with the square of the range, across little;
its errors last over neighbouring frames; poles differ in how visible they are; chance detections
come up anywhere; parked vans stand there for one drive and not the next. The reference errs too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import PoleScan, VisibleRegion
from polemap.drivelog.streams import ReferenceStream

Floats = NDArray[np.float64]

FRAME = EarthFrame("utm", 32632)
ORIGIN = np.array([458000.0, 5_430_000.0])
BLOCK_M = 120.0
RATE_HZ = 10.0
SPEED_MPS = 10.0
RANGE_M = 30.0
HALF_VIEW_RAD = 0.6
ERROR_TIME_S = 0.3
FOCAL_BASELINE_PX_M = 247.0
PASS_GAP_S = 20.0


@dataclass(frozen=True)
class Town:
    """Poles `(n, 2)`, their widths and how visible they are."""

    points_m: Floats
    width_m: Floats
    visibility: Floats

    def change(self, removed: NDArray[np.int64], added_m: Floats, moves: dict[int, Floats]) -> Town:
        """The town after works in its streets."""
        points = self.points_m.copy()
        for row, by in moves.items():
            points[row] += by
        keep = np.setdiff1d(np.arange(len(points)), removed)
        n = len(added_m)
        return Town(
            np.concatenate([points[keep], added_m]),
            np.concatenate([self.width_m[keep], np.full(n, 0.2)]),
            np.concatenate([self.visibility[keep], np.full(n, 0.8)]),
        )


@dataclass(frozen=True)
class DriveThrough:
    """What one drive recorded, and where the car really was."""

    scans: list[PoleScan]
    reference: ReferenceStream
    true_poses: Floats


def make_town(rng: np.random.Generator, blocks: int = 3) -> Town:
    """Lamps and trees on both sides of a grid of streets; every twentieth has a close neighbour."""
    points = []
    length = blocks * BLOCK_M
    for street in range(blocks + 1):
        for side in (-6.0, 6.0):
            along = np.arange(12.0, length - 8.0, 24.0)
            along = along + rng.uniform(-6.0, 6.0, len(along))
            across = street * BLOCK_M + side + rng.uniform(-1.5, 1.5, len(along))
            points += [np.stack([along, across], 1), np.stack([across, along], 1)]
    every = np.concatenate(points)
    twins = every[rng.random(len(every)) < 0.05]
    angle = rng.uniform(0, 2 * np.pi, len(twins))
    twins = twins + 1.6 * np.stack([np.cos(angle), np.sin(angle)], 1)
    every = _thin(np.concatenate([every, twins]), 1.3)
    n = len(every)
    return Town(every + ORIGIN, rng.uniform(0.08, 0.5, n), rng.beta(6.0, 2.0, n))


def _thin(points: Floats, least_m: float) -> Floats:
    kept: list[Floats] = []
    for point in points:
        if all(np.hypot(*(point - other)) >= least_m for other in kept):
            kept.append(point)
    return np.array(kept)


def route(blocks: int = 3) -> Floats:
    """Poses `(n, 3)` through every street of the grid, there and back, at 10 Hz."""
    length = blocks * BLOCK_M
    corners: list[tuple[float, float]] = []
    for k in range(blocks + 1):
        ends = [(0.0, k * BLOCK_M), (length, k * BLOCK_M)]
        corners += ends if k % 2 == 0 else ends[::-1]
    for k in range(blocks, -1, -1):
        ends = [(k * BLOCK_M, 0.0), (k * BLOCK_M, length)]
        corners += ends[::-1] if (blocks - k) % 2 == 0 else ends
    corners += corners[::-1]
    path = np.array(corners)
    path = path[np.concatenate([[True], np.linalg.norm(np.diff(path, axis=0), axis=1) > 1.0])]
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    s = np.arange(0.0, station[-1], SPEED_MPS / RATE_HZ)
    xy = np.stack([np.interp(s, station, path[:, axis]) for axis in (0, 1)], axis=1)
    # corners are rounded over ten metres, so that the car can take them
    kernel = np.ones(11) / 11.0
    padded = np.pad(xy, ((5, 5), (0, 0)), mode="edge")
    xy = np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
    heading = np.gradient(xy, axis=0)
    return np.column_stack([xy + ORIGIN, np.arctan2(heading[:, 1], heading[:, 0])])


def drive_through(
    town: Town,
    rng: np.random.Generator,
    *,
    start_s: float,
    poses: Floats | None = None,
    reference_sd_m: float = 0.05,
    reference_time_s: float = 20.0,
    shift_m: Floats | None = None,
    vans: int = 10,
    clutter: float = 0.3,
    disparity_bias_px: tuple[float, float] | None = None,
) -> DriveThrough:
    """One drive: every look sees poles in view by chance, with noise, and some that are none.

    Args:
        town: what stands there.
        rng: of all noise.
        start_s: stamp of the first look.
        poses: of the car; the whole grid by default.
        reference_sd_m: an axis, correlated over `reference_time_s`.
        shift_m: `(2,)` by which the whole reference is off.
        vans: things that stand there for this drive only.
        clutter: chance detections a look.
        disparity_bias_px: error of every disparity, and sd of what each pass at a pole adds to it.
    """
    poses = route() if poses is None else poses
    stamps = start_s + np.arange(len(poses)) / RATE_HZ
    near = poses[rng.integers(0, len(poses), vans), :2] + rng.uniform(-7, 7, (vans, 2))
    points = np.concatenate([town.points_m, near])
    width = np.concatenate([town.width_m, np.full(vans, 0.15)])
    seen = np.concatenate([town.visibility, np.full(vans, 0.7)])
    last = np.zeros((len(points), 2))
    bias = _PassBias(len(points), disparity_bias_px)
    keep = np.exp(-1.0 / (RATE_HZ * ERROR_TIME_S))
    view = VisibleRegion(
        np.array([1.5, 0.0]), -HALF_VIEW_RAD, HALF_VIEW_RAD, 3.0, np.array([RANGE_M])
    )
    scans = []
    for stamp, pose in zip(stamps, poses, strict=True):
        # white in unit variance, but alike from frame to frame
        last = keep * last + np.sqrt(1 - keep**2) * rng.standard_normal(last.shape)
        scans.append(_look(stamp, pose, points, width, seen, last, view, clutter, bias, rng))
    offset = np.zeros(2) if shift_m is None else shift_m
    error = gauss_markov(len(poses), reference_sd_m, reference_time_s, rng) + offset
    measured = poses + np.column_stack([error, 0.001 * rng.standard_normal(len(poses))])
    return DriveThrough(
        scans, ReferenceStream(stamps, measured, np.full(len(poses), reference_sd_m)), poses
    )


class _PassBias:
    """What a stereo camera's disparity is off at each pole: alike in all looks of one pass."""

    def __init__(self, poles: int, bias_px: tuple[float, float] | None) -> None:
        self._common_px, self._sd_px = bias_px or (0.0, 0.0)
        self._off = bias_px is None
        self._bias_px = np.zeros(poles)
        self._last_s = np.full(poles, -np.inf)

    def at(self, poles: NDArray[np.int64], stamp_s: float, rng: np.random.Generator) -> Floats:
        """Error of the disparities `(k,)` of poles that are seen now."""
        if self._off:
            return np.zeros(len(poles))
        fresh = poles[self._last_s[poles] < stamp_s - PASS_GAP_S]
        self._bias_px[fresh] = self._common_px + self._sd_px * rng.standard_normal(len(fresh))
        self._last_s[poles] = stamp_s
        return self._bias_px[poles]


def gauss_markov(n: int, sd: float, time_s: float, rng: np.random.Generator) -> Floats:
    keep = np.exp(-1.0 / (RATE_HZ * time_s))
    error = np.empty((n, 2))
    error[0] = sd * rng.standard_normal(2)
    for row in range(1, n):
        error[row] = keep * error[row - 1] + sd * np.sqrt(1 - keep**2) * rng.standard_normal(2)
    return error


def _look(
    stamp: float,
    pose: Floats,
    points: Floats,
    width: Floats,
    seen: Floats,
    error: Floats,
    view: VisibleRegion,
    clutter: float,
    bias: _PassBias,
    rng: np.random.Generator,
) -> PoleScan:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    close = np.flatnonzero((np.abs(points - pose[:2]) < RANGE_M + 3.0).all(axis=1))
    offset = points[close] - pose[:2]
    local = np.stack(
        [c * offset[:, 0] + s * offset[:, 1], -s * offset[:, 0] + c * offset[:, 1]], axis=1
    )
    visible = view.contains(local)
    close, local = close[visible], local[visible]
    distance = np.hypot(*local.T)
    chosen = rng.random(len(close)) < seen[close] * np.clip(1.3 - distance / RANGE_M, 0.2, 1.0)
    close, local, distance = close[chosen], local[chosen], distance[chosen]
    chance = rng.poisson(clutter)
    r = RANGE_M * np.sqrt(rng.random(chance))
    b = rng.uniform(-HALF_VIEW_RAD, HALF_VIEW_RAD, chance)
    wrong = np.stack([1.5 + r * np.cos(b), r * np.sin(b)], axis=1)
    local = np.concatenate([local, wrong])
    unit = np.concatenate([error[close], rng.standard_normal((chance, 2))])
    distance, bearing = np.hypot(*local.T), np.arctan2(local[:, 1], local[:, 0])
    along, across = 0.03 + 0.0008 * distance**2, 0.02 + 0.003 * distance
    ray = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    side = np.stack([-ray[:, 1], ray[:, 0]], axis=1)
    measured = local + ray * (along * unit[:, 0])[:, None] + side * (across * unit[:, 1])[:, None]
    offset = local[: len(close)] - view.origin_vehicle_m
    far = np.hypot(*offset.T)
    moved = far / FOCAL_BASELINE_PX_M * bias.at(close, stamp, rng)
    measured[: len(close)] += offset * moved[:, None]
    covariance = (along**2)[:, None, None] * ray[:, :, None] * ray[:, None, :]
    covariance = covariance + (across**2)[:, None, None] * side[:, :, None] * side[:, None, :]
    n = len(local)
    widths = np.concatenate([width[close], rng.uniform(0.05, 0.6, chance)])
    return PoleScan(
        float(stamp),
        float(stamp),
        measured,
        covariance,
        np.abs(widths + 0.05 * rng.standard_normal(n)),
        np.full(n, -1, dtype=np.int64),
        np.ones(n),
        view,
    )


def passed(town: Town, poses: Floats, within_m: float = 20.0, looks: int = 5) -> NDArray[np.bool_]:
    """Which poles a drive had in its field of view, near enough, often enough."""
    count = np.zeros(len(town.points_m), dtype=np.int64)
    view = VisibleRegion(
        np.array([1.5, 0.0]), -HALF_VIEW_RAD, HALF_VIEW_RAD, 3.0, np.array([within_m])
    )
    for east, north, yaw in poses:
        offset = town.points_m - (east, north)
        c, s = np.cos(yaw), np.sin(yaw)
        local = np.stack(
            [c * offset[:, 0] + s * offset[:, 1], -s * offset[:, 0] + c * offset[:, 1]], axis=1
        )
        count += view.contains(local)
    return count >= looks
