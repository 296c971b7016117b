"""A drive condensed to a node every thirty metres: what is kept of it when drives are many.

The drive is cut into sections of about a kilometre. Each is solved by itself from odometry and
poles, without fixes, and then stands for

    x_i^-1 x_(i+1) = m + J (c - c0) + e,   e ~ N(0, R)

between successive nodes: m is the solved motion, J and R are the regression on the calibration c
and what it leaves, from the joint marginal covariance of nodes and calibration. What the poles told
of c itself is kept as information, its prior taken out. Fixes are not condensed: they count where
all drives are solved together (`skeleton`).

Source: Ni, Steedly, Dellaert, Tectonic SAM: exact, out-of-core, submap-based SLAM, ICRA 2007;
Grisetti, Kuemmerle, Ni, Robust optimization of factor graphs by using condensed measurements,
IROS 2012.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from polemap.build.build_map import observe
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations
from polemap.build.slam.config import SlamConfig
from polemap.build.slam.constants import KEYFRAME_M, SUBMAP_M
from polemap.build.slam.initial import FIXES_MIN, lay_on_fixes
from polemap.build.slam.loops import relative_with_jacobian
from polemap.build.slam.motion import Increments, MotionNoise, Path, increments
from polemap.build.slam.noise import seen_residuals, stated_noise
from polemap.build.slam.rounds import Builder, State
from polemap.build.slam.route import Route, check_route, open_route
from polemap.build.slam.tables import calibration_sd
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.pose import compose, relative, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_NODE_KEYFRAMES = round(SUBMAP_M / KEYFRAME_M)
_SECTION_NODES = 33  # about a kilometre
_MARGIN_KEYFRAMES = 20  # solved beside a section, so that its ends are known as well as its middle
_POSE_SD_M = 0.1  # of a pass against its neighbours, as in `association`
_PATH_S = 0.1
_SHIFT_M = 1000.0


@dataclass(frozen=True, slots=True)
class Condensed:
    """One drive as all drives together see it.

    Attributes:
        name: of the drive in the map; frame: of its fixes.
        stamp_s: `(n,)` of the nodes; chain: `(n, 3)` their poses, section laid onto section.
        path: the same ten times a second.
        steps: motion between nodes, about `calibration`.
        calibration: `(k, 6)` of the sections; calibration_s: `(k,)` where they begin.
        known, information: `(k, 6)`, `(k, 6, 6)` what poles say of the calibration.
        fix_s, fix_m, hdop: `(c,)`, `(c, 2)`, `(c,)` of the fixes, in `frame`.
        antenna_m: `(2,)`.
        residual_m: median of detections against their landmarks.
        observed: scans, detections and landmarks of passes, at the poses of `path`.
    """

    name: str
    frame: EarthFrame
    stamp_s: Floats
    chain: Floats
    path: Path
    steps: Increments
    calibration: Floats
    calibration_s: Floats
    known: Floats
    information: Floats
    fix_s: Floats
    fix_m: Floats
    hdop: Floats
    antenna_m: Floats
    residual_m: float
    observed: DriveObservations

    @property
    def order(self) -> tuple[float, str]:
        """Drives are put in order by this, however they were given."""
        return (float(self.stamp_s[0]), self.name)


@dataclass(frozen=True, slots=True)
class _Section:
    """One solved section between its nodes."""

    steps: Increments
    calibration: Floats
    known: Floats
    information: Floats
    poses: Floats
    residual_m: float


def condense(
    name: str,
    drive: Drive,
    scans: Sequence[Detections],
    mapping: MappingConfig,
    config: SlamConfig,
    noise: MotionNoise,
    frame: EarthFrame,
) -> Condensed:
    """Solve a drive section by section, and keep what `Condensed` names.

    Args:
        name: of the drive in the map.
        drive: with odometry.
        scans: poles seen on it.
        mapping, config, noise: as in `solve_slam`.
        frame: of the map.

    Raises:
        InputError: as `solve_slam`.
        FrameError: no transformation leads from the drive's frame to `frame`.
    """
    route = open_route(name, drive, frame, np.zeros(2), noise)
    check_route(route, scans)
    shift = np.zeros(2)
    if len(route.fix_m):
        shift = np.round(np.median(route.fix_m, axis=0) / _SHIFT_M) * _SHIFT_M
    near = replace(route, fix_m=route.fix_m - shift)
    nodes = np.unique([*range(0, len(route), _NODE_KEYFRAMES), len(route) - 1])
    if len(nodes) > 2 and nodes[-1] - nodes[-2] < _NODE_KEYFRAMES // 2:
        nodes = np.delete(nodes, -2)
    count = max(1, round((len(nodes) - 1) / _SECTION_NODES))
    cuts = np.round(np.linspace(0, len(nodes) - 1, count + 1)).astype(np.int64)
    sections, chain = [], np.zeros((len(route.path.stamp_s), 3))
    end = np.zeros(3)
    stamps = route.path.stamp_s
    looked = np.array([scan.stamp_s for scan in scans])
    for first, last in pairwise(cuts.tolist()):
        mine = nodes[first : last + 1]
        section, solved = _solve(near, mine, scans, looked, mapping, config, frame)
        sections.append(section)
        low, high = route.stamp_s[mine[0]], route.stamp_s[mine[-1]]
        rows = slice(*np.searchsorted(stamps, [low, high]))
        if last == len(nodes) - 1:
            rows = slice(rows.start, len(stamps))
        chain[rows] = compose(end, relative(section.poses[0], solved.poses_at(stamps[rows])))
        end = compose(end, relative(section.poses[0], section.poses[-1]))
    chain[:, 2] = np.unwrap(chain[:, 2])
    path = _thinned(replace(route.path, poses=chain))
    steps = [section.steps for section in sections]
    return Condensed(
        name=name,
        frame=frame,
        stamp_s=route.stamp_s[nodes],
        chain=path.at(route.stamp_s[nodes]),
        path=path,
        steps=Increments(
            np.concatenate([step.motion for step in steps]),
            np.concatenate([step.jacobian for step in steps]),
            np.concatenate([step.covariance for step in steps]),
        ),
        calibration=np.array([section.calibration for section in sections]),
        calibration_s=route.stamp_s[nodes[cuts[:-1]]],
        known=np.array([section.known for section in sections]),
        information=np.array([section.information for section in sections]),
        fix_s=route.fix_s,
        fix_m=route.fix_m,
        hdop=route.hdop,
        antenna_m=route.antenna_m,
        residual_m=median_m([section.residual_m for section in sections]),
        observed=_observed(name, drive, scans, looked, path, mapping, frame),
    )


def median_m(values: Sequence[float]) -> float:
    """Median of those that are known, NaN where none is."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def _solve(
    route: Route,
    nodes: Whole,
    scans: Sequence[Detections],
    looked: Floats,
    mapping: MappingConfig,
    config: SlamConfig,
    frame: EarthFrame,
) -> tuple[_Section, Route]:
    """One section between its nodes, by odometry and poles; fixes only say where to begin."""
    first = max(int(nodes[0]) - _MARGIN_KEYFRAMES, 0)
    part = _cut(route, first, min(int(nodes[-1]) + _MARGIN_KEYFRAMES, len(route) - 1))
    inside = slice(*np.searchsorted(looked, part.stamp_s[[0, -1]] + (-0.5, 0.5)))
    builder = Builder([scans[inside]], mapping, config, frame)
    level = stated_noise(config)
    if len(part.fix_s) >= FIXES_MIN:
        part = lay_on_fixes(part, config)
    else:
        part = builder.calibrate([_without_fixes(part)], level)[0]
    state = builder.solve([part], builder.associate([part]), level)
    level = replace(level, seen_variance=builder.measured(state).seen_variance)
    begun = _without_fixes(state.routes[0])
    state = builder.solve([begun], builder.associate([begun]), level)
    return _condensed(state, nodes - first), state.routes[0]


def _cut(route: Route, first: int, last: int) -> Route:
    """The keyframes from first to last with odometry and fixes along them, of one calibration."""
    stamps = route.stamp_s[first : last + 1]
    low, high = np.searchsorted(route.odometry.stamp_s, stamps[[0, -1]])
    odometry = route.odometry.take(slice(max(int(low) - 1, 0), int(high) + 2))
    calibration = np.zeros((1, route.calibration.shape[1]))
    path, steps = increments(odometry, calibration[0], route.noise, stamps)
    fixes = (route.fix_s >= stamps[0]) & (route.fix_s <= stamps[-1])
    return replace(
        route, odometry=odometry, stamp_s=stamps, poses=path.at(stamps), calibration=calibration,
        calibration_s=stamps[:1], path=path, steps=steps, fix_s=route.fix_s[fixes],
        fix_m=route.fix_m[fixes], hdop=route.hdop[fixes],
    )  # fmt: skip


def _without_fixes(route: Route) -> Route:
    return replace(route, fix_s=np.empty(0), fix_m=np.empty((0, 2)), hdop=np.empty(0))


def _thinned(path: Path) -> Path:
    """The way ten times a second at most, which is all that is kept of a drive's odometry."""
    tick = np.floor(path.stamp_s / _PATH_S)
    keep = np.concatenate([[True], np.diff(tick) > 0])
    keep[-1] = True
    none = np.empty((np.count_nonzero(keep), 0))
    return Path(path.stamp_s[keep], path.poses[keep], path.travelled_m[keep], none)


def _condensed(state: State, nodes: Whole) -> _Section:
    """Motions between the nodes, and what is known of the calibration."""
    poses = state.solution.poses[nodes]
    c0 = state.solution.calibration[0]
    n, size = len(nodes), len(c0)
    joint = state.graph.covariance(nodes, np.empty(0, dtype=np.int64), [0])
    motion = relative(poses[:-1], poses[1:])
    own = joint[3 * n :, 3 * n :]
    inverse = np.linalg.inv(own)
    jacobian, covariance = np.empty((n - 1, 3, size)), np.empty((n - 1, 3, 3))
    for row in range(n - 1):
        by = relative_with_jacobian(poses, row, row + 1)[1]
        ends = slice(3 * row, 3 * row + 6)
        cross = by @ joint[ends, 3 * n :]
        jacobian[row] = cross @ inverse
        left = by @ joint[ends, ends] @ by.T - jacobian[row] @ cross.T
        covariance[row] = 0.5 * (left + left.T) + np.diag([1e-6, 1e-6, 1e-8])
    known, information = _without_prior(c0, own)
    problem, solution = state.problem, state.solution
    off = np.hypot(*seen_residuals(problem, solution).T) if len(problem.seen) else np.empty(0)
    return _Section(
        Increments(motion, jacobian, covariance), c0, known, information, poses,
        float(np.median(off)) if len(off) else float("nan"),
    )  # fmt: skip


def _without_prior(mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Mean and information of a calibration without its prior, which all sections share."""
    sd = calibration_sd()
    inverse = np.linalg.inv(covariance / np.outer(sd, sd))
    value, vector = np.linalg.eigh(inverse - np.eye(len(sd)))
    value = np.maximum(value, 1e-6)
    information = (vector * value) @ vector.T
    known = (vector / value) @ vector.T @ inverse @ (mean / sd)
    return known * sd, information / np.outer(sd, sd)


def _observed(
    name: str,
    drive: Drive,
    scans: Sequence[Detections],
    looked: Floats,
    path: Path,
    mapping: MappingConfig,
    frame: EarthFrame,
) -> DriveObservations:
    """What the drive saw, at the poses of its chain."""
    inside = (looked >= path.stamp_s[0] - 0.5) & (looked <= path.stamp_s[-1] + 0.5)
    stamps = np.unique(looked[inside])
    poses = path.at(stamps)
    poses[:, 2] = wrap_angle(poses[:, 2])
    reference = ReferenceStream(stamps, poses, np.full(len(stamps), _POSE_SD_M))
    placed = replace(drive, frame=frame, reference=reference)
    mine = [scan for scan, usable in zip(scans, inside.tolist(), strict=True) if usable]
    return observe(placed, name, mine, mapping, frame)
