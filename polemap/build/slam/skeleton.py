"""Many condensed drives solved together: nodes, poles of passes and fixes in one graph.

The rounds are those of single drives (`rounds`): loops, poles that passes share, GNSS. What differs
is what a drive is: a node every thirty metres with the motions between them (`condense`), and every
pole of a pass seen from the node that is nearest. Loops are looked for region by region, each
with the joint covariance of its own nodes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations, join_cannot_link
from polemap.build.slam.association import Seen
from polemap.build.slam.condense import Condensed, median_m
from polemap.build.slam.config import SlamConfig
from polemap.build.slam.graph import Graph
from polemap.build.slam.initial import lay_on_fixes
from polemap.build.slam.loop import Found, Loop
from polemap.build.slam.loops import OVERLAP_M, SEARCH_SD_M, find_loops, recall_loops
from polemap.build.slam.motion import Increments, MotionNoise
from polemap.build.slam.nodes import placed, poles_of
from polemap.build.slam.noise import Noise, stated_noise
from polemap.build.slam.rounds import Builder, State, close_loops, settle
from polemap.build.slam.route import Route
from polemap.build.slam.slam import SHIFT_M, SlamResult, check_fixed, result_of, twin_error
from polemap.build.slam.submaps import Submap
from polemap.build.slam.tables import gather, pose_starts
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import OdometryStream
from polemap.vehicle.pose import (
    rotate,
    rotate_covariance,
    transform_points,
    wrap_angle,
)

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_REGION_M = 150.0
_RECALLED_MOST = 1000  # local maps whose joint covariance is held at once, 30 km of way
_REACH_M = OVERLAP_M + 3.0 * SEARCH_SD_M
_NO_ODOMETRY = OdometryStream(np.empty(0), np.empty(0), np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True)
class CondensedRoute(Route):
    """A route whose keyframes are the nodes of a condensed drive.

    Attributes:
        known, information: `(k, 6)`, `(k, 6, 6)` what its poles say of its calibration.
    """

    known: Floats
    information: Floats

    def calibration_knowledge(self) -> tuple[Floats, Floats]:
        """See `Route`."""
        return self.known, self.information

    def with_calibration(self, calibration: Floats) -> CondensedRoute:
        """The route with its motions about another calibration: they are linear in it."""
        change = (calibration - self.calibration)[self.calibration_of(self.stamp_s[:-1])]
        moved = self.steps.motion + np.einsum("nij,nj->ni", self.steps.jacobian, change)
        steps = Increments(moved, self.steps.jacobian, self.steps.covariance)
        return replace(self, calibration=calibration, steps=steps)


class CondensedBuilder(Builder):
    """The rounds over condensed drives."""

    beside = 0

    def __init__(
        self,
        parts: Sequence[Condensed],
        mapping: MappingConfig,
        config: SlamConfig,
        frame: EarthFrame,
    ) -> None:
        super().__init__((), mapping, config, frame)
        self._parts = [poles_of(part) for part in parts]
        starts = np.cumsum([0, *(len(part.stamp_s) for part in parts)])
        counts = [len(one.landmarks) for one in self._parts]
        first = np.cumsum([0, *counts])
        self._cannot_link = join_cannot_link([one.cannot_link for one in self._parts], counts)
        self._detections = sum(len(part.observed.rows) for part in parts)
        self._submaps = [
            replace(
                submap,
                route=number,
                anchor=int(submap.anchor + starts[number]),
                landmark=submap.landmark + first[number],
            )
            for number, one in enumerate(self._parts)
            for submap in one.local
        ]

    def associate(self, routes: Sequence[Route]) -> Seen:
        """The poles of passes, moved with their nodes."""
        moved, nodes = [], []
        starts = pose_starts(routes)
        for route, one, start in zip(routes, self._parts, starts, strict=False):
            pose = route.poses[one.node]
            turn = wrap_angle(pose[:, 2] - one.turn_rad)
            marks = one.landmarks
            moved.append(
                marks.with_columns(
                    points_m=transform_points(pose, one.point_m),
                    covariance_m2=rotate_covariance(marks.covariance_m2, turn),
                    gain_m_per_px=rotate(marks.gain_m_per_px, turn),
                    direction_rad=wrap_angle(marks.direction_rad + turn),
                )
            )
            nodes.append(one.node + start)
        joined = TraversalLandmarks.concatenate(moved)
        sightings = gather(
            np.concatenate(nodes),
            np.arange(len(joined)),
            np.concatenate([one.point_m for one in self._parts]),
            np.concatenate([one.covariance_m2 for one in self._parts]),
            np.array(joined.points_m),
        )
        return Seen(sightings, joined, self._cannot_link, self._detections)

    def measured(self, state: State) -> Noise:
        """The noise of the fixes; that of detections was found where drives were condensed."""
        return replace(super().measured(state), seen_variance=1.0)

    def submaps(self, state: State) -> list[Submap]:
        """See `Builder`; those of condensed drives never change."""
        return self._submaps

    def find_loops(
        self,
        submaps: Sequence[Submap],
        poses: Floats,
        anchors: Whole,
        graph: Graph,
        known: Collection[tuple[int, int]],
    ) -> Found:
        """See `Builder`; region by region, or by patterns where it is not known where to look."""
        cell = np.floor(poses[:, :2] / _REGION_M).astype(np.int64)
        loops: list[Loop] = []
        ambiguous = at_odds = 0
        lost = False
        for place in np.unique(cell, axis=0):
            middle = (place + 0.5) * _REGION_M
            off = np.abs(poses[:, :2] - middle).max(axis=1)
            rows = np.flatnonzero(off <= 0.5 * _REGION_M + _REACH_M)
            covariance = graph.covariance(anchors[rows], np.empty(0, dtype=np.int64))
            index = 3 * np.arange(len(rows))
            spread = covariance[index, index] + covariance[index + 1, index + 1]
            lost |= bool((spread > SEARCH_SD_M**2).any())
            own = (cell[rows] == place).all(axis=1)
            found = find_loops(
                [submaps[row] for row in rows.tolist()], poses[rows], covariance, self.config,
                known, numbers=rows, own=own,
            )  # fmt: skip
            loops += found.loops
            ambiguous += found.ambiguous
            at_odds += found.at_odds
        if not loops and lost and len(submaps) <= _RECALLED_MOST:
            covariance = graph.covariance(anchors, np.empty(0, dtype=np.int64))
            return recall_loops(submaps, poses, covariance, self.config, known)
        return Found(tuple(loops), ambiguous, at_odds, lost)


def solve_condensed(
    parts: Sequence[Condensed], mapping: MappingConfig, config: SlamConfig
) -> tuple[SlamResult, list[DriveObservations]]:
    """Solve condensed drives together; what they saw, at the solved poses.

    The drives are put in order by their time first, so that the result does not depend on how
    they were given. Both come back in the order given.

    Raises:
        InputError: one of several drives has no fix; one is another one again.
    """
    order = sorted(range(len(parts)), key=lambda row: parts[row].order)
    given = [parts[row] for row in order]
    frame, shift = _origin(given)
    opened = [_route(part, shift) for part in given]
    check_fixed([part.name for part in given], [len(part.fix_s) > 0 for part in given])
    _check_twins(given)
    routes: list[Route] = [lay_on_fixes(route, config, thin=False) for route in opened]
    builder = CondensedBuilder(given, mapping, config, frame)
    level = stated_noise(config)
    state = builder.solve(routes, builder.associate(routes), level)
    state = builder.solve(state.routes, builder.associate(state.routes), builder.measured(state))
    state, closed = close_loops(builder, state)
    state = settle(builder, state)
    stamps = [part.observed.detections.views.stamp_s for part in given]
    result = result_of(builder, state, closed, stamps, frame, shift, every=1)
    seen = [
        placed(part, route, shift, frame, reference)
        for part, route, reference in zip(given, state.routes, result.references, strict=True)
    ]
    residual = median_m([part.residual_m for part in given])
    result = replace(result, summary=replace(result.summary, detection_residual_m=residual))
    back = np.argsort(order)
    return result.in_order(back.tolist()), [seen[row] for row in back]


def _origin(parts: Sequence[Condensed]) -> tuple[EarthFrame, Floats]:
    """The frame of the map, and where the graph's own origin lies in it."""
    fixed = [part for part in parts if len(part.fix_m)]
    if not fixed:
        return EarthFrame("local", name=parts[0].name), np.zeros(2)
    middle = np.median(np.concatenate([part.fix_m for part in fixed]), axis=0)
    return fixed[0].frame, np.asarray(np.round(middle / SHIFT_M) * SHIFT_M)


def _route(part: Condensed, shift_m: Floats) -> CondensedRoute:
    return CondensedRoute(
        name=part.name,
        odometry=_NO_ODOMETRY,
        noise=MotionNoise(),
        stamp_s=part.stamp_s,
        poses=part.chain,
        calibration=part.calibration,
        calibration_s=part.calibration_s,
        path=part.path,
        steps=part.steps,
        fix_s=part.fix_s,
        fix_m=part.fix_m - shift_m,
        hdop=part.hdop,
        antenna_m=part.antenna_m,
        by_camera=False,  # what is known of it is in what the drive's sections say
        known=part.known,
        information=part.information,
    )


def _check_twins(parts: Sequence[Condensed]) -> None:
    for number, part in enumerate(parts):
        for other in parts[:number]:
            one, two = part.path.travelled_m, other.path.travelled_m
            if len(one) == len(two) and np.allclose(one, two, rtol=0.0, atol=1e-6):
                raise twin_error(part.name, other.name)
