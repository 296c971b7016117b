"""Poses and poles without a reference, on one screen.

odometry and GNSS -> routes -> landmarks of single passes -> loops -> poles -> poses with covariance

The poses then serve map building as any reference does (`build_map`), with what they are known to
against the poles beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import KEYFRAME_M, SUBMAP_M
from polemap.build.slam.initial import FIXES_MIN, lay_on_fixes
from polemap.build.slam.known import KnownPoles, lay_on_localized
from polemap.build.slam.motion import MotionNoise
from polemap.build.slam.noise import stated_noise
from polemap.build.slam.precision import anchor_keyframes, graph_to_state, pose_precision
from polemap.build.slam.report import SlamSummary
from polemap.build.slam.rounds import Builder, Closed, State, close_loops, settle
from polemap.build.slam.route import Route, as_reference, check_route, open_route
from polemap.build.slam.summary import summarise
from polemap.build.slam.tables import pose_starts
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import ReferenceStream
from polemap.map.pole_map import PoleMap
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_LOCAL_ROUNDS = 2
_GRID_S = 0.1  # of the poses that are written, beside the scans
SHIFT_M = 1000.0  # coordinates of a grid are solved near the origin, where they keep their digits
_POLE_M = 1.0


@dataclass(frozen=True, slots=True)
class SlamResult:
    """Solved drives, in the order in which they were given.

    Attributes:
        frame: of the poses; a local one of the first drive where no drive has a fix.
        references: as a reference for map building; `sd_m` against the poles beside.
        trajectories: the same poses with their covariance to the earth (without fixes: to the
            first pose).
        summary: figures.
    """

    frame: EarthFrame
    references: tuple[ReferenceStream, ...]
    trajectories: tuple[Trajectory, ...]
    summary: SlamSummary
    _state: State
    _shift_m: Floats
    _relative_sd_m: Floats

    def with_precision(self, pole_map: PoleMap, rows: NDArray[np.bool_] | None = None) -> PoleMap:
        """A map that was built with these poses, with what the graph knows of its poles.

        Passes of one graph agree by construction, so that their disagreement, by which map
        building measures a reference, says too little. What a pose is known to against the poles
        beside it is added, as one error a pass, to all poles or to `rows` `(n,)`; covariances to
        the earth come as columns.
        """
        if not len(pole_map):
            return pole_map
        routes = np.concatenate([route.poses[:, :2] for route in self._state.routes])
        _, row = scipy.spatial.KDTree(routes).query(pole_map.points_m - self._shift_m)
        passes = np.maximum(pole_map.extra["passes"], 1)
        own = self._relative_sd_m[np.asarray(row)] ** 2 / passes
        if rows is not None:
            own = np.where(rows, own, 0.0)
        return replace(
            pole_map,
            covariance_m2=pole_map.covariance_m2 + own[:, None, None] * np.eye(2),
            extra={**pole_map.extra, **self.absolute_columns(pole_map)},
        )

    def in_order(self, rows: Sequence[int]) -> SlamResult:
        """The same with its drives in another order."""
        return replace(
            self,
            references=tuple(self.references[row] for row in rows),
            trajectories=tuple(self.trajectories[row] for row in rows),
            summary=replace(self.summary, drives=tuple(self.summary.drives[row] for row in rows)),
        )

    def absolute_columns(self, pole_map: PoleMap) -> dict[str, Floats]:
        """Columns of a map that was built from these drives: covariance to the earth `(n,)`.

        `absolute_var_east_m2`, `absolute_var_north_m2`, `absolute_cov_east_north_m2`; NaN for a
        pole that the graph did not hold.
        """
        covariance = np.full((len(pole_map), 2, 2), np.nan)
        points = self._state.solution.points_m
        if len(points) and len(pole_map):
            # poles of several passes stand last, and count before the passes themselves
            distance, row = scipy.spatial.KDTree(points).query(pole_map.points_m - self._shift_m)
            near = np.flatnonzero(distance <= _POLE_M)
            own = self._state.graph.landmark_covariance(np.asarray(row)[near].astype(np.int64))
            covariance[near] = own
        return {
            "absolute_var_east_m2": covariance[:, 0, 0],
            "absolute_var_north_m2": covariance[:, 1, 1],
            "absolute_cov_east_north_m2": covariance[:, 0, 1],
        }


def solve_slam(
    drives: Sequence[tuple[str, Drive]],
    scans: Sequence[Sequence[Detections]],
    mapping: MappingConfig,
    config: SlamConfig,
    noise: MotionNoise,
    frame: EarthFrame,
) -> SlamResult:
    """Solve poses, poles, odometry calibration and GNSS errors of all drives together.

    Args:
        drives: with their names in the map.
        scans: poles seen on each drive.
        mapping: settings of map building, whose association serves here too.
        config: settings.
        noise: of the odometry.
        frame: of the map; taken only where a drive has fixes.

    Raises:
        InputError: a drive without odometry, without movement or without scans; several drives, of
            which one has no fix, or is another one again.
        FrameError: no transformation leads from a drive's frame to `frame`.
        MissingExtraError: gtsam is not installed.
    """
    frame, shift = _origin(drives, frame)
    opened = [open_route(name, drive, frame, shift, noise) for name, drive in drives]
    _check(opened, scans)
    routes: Sequence[Route] = [lay_on_fixes(route, config) for route in opened]
    builder = Builder(scans, mapping, config, frame)
    level = stated_noise(config)
    if any(len(route.fix_s) < FIXES_MIN for route in routes):
        routes = builder.calibrate(routes, level)
    state = builder.solve(routes, builder.associate(routes), level)
    for _ in range(1, _LOCAL_ROUNDS):
        seen = builder.associate(state.routes)
        state = builder.solve(state.routes, seen, builder.measured(state))
    state, closed = close_loops(builder, state)
    state = settle(builder, state)
    return result_of(builder, state, closed, [_stamps(part) for part in scans], frame, shift)


def solve_in_map(
    name: str,
    drive: Drive,
    scans: Sequence[Detections],
    found: Trajectory,
    pole_map: PoleMap,
    mapping: MappingConfig,
    config: SlamConfig,
    noise: MotionNoise,
) -> SlamResult:
    """Solve a drive that was localized in a map which has a part of its poles only.

    Poles of the map hold the graph where they are seen; between them odometry, fixes, loops and
    poles that the map lacks carry it on. Nothing jumps where the map begins again: what the way
    between was off by is spread over it.

    Args:
        name: of the drive in the map.
        drive: with odometry, in the map's frame.
        scans: poles seen on it.
        found: the localizer's poses with covariance.
        pole_map: the map.
        mapping, config, noise: as in `solve_slam`.

    Raises:
        InputError: as `solve_slam`, or the drive was nowhere localized well.
    """
    frame = pole_map.frame
    shift = np.round(pole_map.points_m.mean(axis=0) / SHIFT_M) * SHIFT_M
    route = open_route(name, drive, frame, shift, noise)
    _check([route], [scans])
    known = KnownPoles.of(pole_map, shift)
    builder = Builder([scans], mapping, config, frame, known)
    routes: Sequence[Route] = [lay_on_localized(route, found, shift, config)]
    state = builder.solve(routes, builder.associate(routes), stated_noise(config))
    for _ in range(1, _LOCAL_ROUNDS):
        seen = builder.associate(state.routes)
        state = builder.solve(state.routes, seen, builder.measured(state))
    state, closed = close_loops(builder, state)
    state = settle(builder, state)
    return result_of(builder, state, closed, [_stamps(scans)], frame, shift)


def _origin(drives: Sequence[tuple[str, Drive]], frame: EarthFrame) -> tuple[EarthFrame, Floats]:
    """The frame that the graph is tied to, and where its own origin lies in it."""
    fixed = [drive for _, drive in drives if drive.gnss is not None and len(drive.gnss)]
    if not fixed:
        return EarthFrame("local", name=drives[0][0]), np.zeros(2)
    gnss = fixed[0].gnss
    assert gnss is not None
    middle = np.array([np.median(gnss.east_m), np.median(gnss.north_m)])
    return frame, np.round(middle / SHIFT_M) * SHIFT_M if fixed[0].frame == frame else np.zeros(2)


def _check(routes: Sequence[Route], scans: Sequence[Sequence[Detections]]) -> None:
    for route, part in zip(routes, scans, strict=True):
        check_route(route, part)
    check_fixed([route.name for route in routes], [len(route.fix_s) > 0 for route in routes])
    check_twins(routes)


def check_fixed(names: Sequence[str], fixed: Sequence[bool]) -> None:
    """Refuse drives that nothing ties to the others.

    Raises:
        InputError: one of several has no fix.
    """
    without = [name for name, known in zip(names, fixed, strict=True) if not known]
    if without and len(names) > 1:
        raise InputError(
            f"drive {without[0]}: it has no GNSS fix, so that nothing says where it lies to the "
            "other drives; build its map by itself, or --update theirs with it"
        )


def check_twins(routes: Sequence[Route]) -> None:
    """Refuse a drive that is given twice.

    Raises:
        InputError: two have the same odometry.
    """
    for number, route in enumerate(routes):
        twin = next((one.name for one in routes[:number] if _same_drive(one, route)), None)
        if twin is not None:
            raise twin_error(route.name, twin)


def twin_error(name: str, other: str) -> InputError:
    """What to say of a drive that is another one again."""
    return InputError(
        f"drive {name}: its odometry is that of drive {other}, value for value; the same drive "
        "given twice tells nothing new: give it once"
    )


def _same_drive(a: Route, b: Route) -> bool:
    """Whether one recording was given twice, under whatever name; stamps may have been moved."""
    one, two = a.odometry, b.odometry
    return (
        len(one) == len(two)
        and bool(np.array_equal(one.speed_mps, two.speed_mps))
        and bool(np.array_equal(one.yaw_rate_radps, two.yaw_rate_radps))
    )


def _stamps(scans: Sequence[Detections]) -> Floats:
    return np.array([scan.stamp_s for scan in scans])


def result_of(
    builder: Builder,
    state: State,
    closed: Closed,
    stamps_s: Sequence[Floats],
    frame: EarthFrame,
    shift: Floats,
    every: int = round(SUBMAP_M / KEYFRAME_M),
) -> SlamResult:
    """The result of a solved state.

    Args:
        builder: what solved it.
        state, closed: the state, and its loops.
        stamps_s: of the scans of every drive.
        frame: of the map.
        shift: `(2,)` from the graph's origin to that of the frame.
        every: keyframes between those whose covariance is computed.
    """
    starts = pose_starts(state.routes)
    submaps = np.array([submap.anchor for submap in builder.submaps(state)], dtype=np.int64)
    anchors = anchor_keyframes(starts, submaps, every)
    fixes = builder.fixes(state)
    graph = graph_to_state(state.problem, state.solution, state.noise.fix, fixes, builder.config)
    state = replace(state, graph=graph, noise=replace(state.noise, fix=fixes))
    precision = pose_precision(state.graph, state.solution, anchors, starts)
    references, trajectories = [], []
    for number, (route, looked) in enumerate(zip(state.routes, stamps_s, strict=True)):
        rows = slice(int(starts[number]), int(starts[number + 1]))
        grid = np.arange(route.stamp_s[0], route.stamp_s[-1], _GRID_S)
        inside = (looked >= route.stamp_s[0] - 0.5) & (looked <= route.stamp_s[-1] + 0.5)
        stamps = np.unique(np.concatenate([looked[inside], grid, route.stamp_s[-1:]]))
        reference = as_reference(route, stamps, shift, precision.relative_sd_m[rows])
        references.append(reference)
        low = np.clip(np.searchsorted(route.stamp_s, stamps, side="right") - 1, 0, len(route) - 1)
        trajectories.append(Trajectory(stamps, reference.poses, precision.absolute[rows][low]))
    summary = summarise(state, closed, precision, starts, shift)
    return SlamResult(
        frame,
        tuple(references),
        tuple(trajectories),
        summary,
        state,
        shift,
        precision.relative_sd_m,
    )
