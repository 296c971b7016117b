"""Lines at many poses: the fast model against a slow plain one, ends of lines, misses."""

from __future__ import annotations

from math import cos, exp, log, pi, sin

import numpy as np
import pytest

from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections, line_detections
from polemap.localize.particle_filter.line_model import (
    KIND_MODELS,
    KNOWN_M,
    Pieces,
    Spread,
    line_log_likelihood,
)
from polemap.localize.particle_filter.line_parts import LineIndex
from polemap.localize.particle_filter.line_weigher import LineWeigher, frame_share
from polemap.map.line_map import LineMap

MARKING, KERB = int(LandmarkKind.LANE_MARKING), int(LandmarkKind.KERB)
ORIGIN_M = np.array([500_000.0, 5_400_000.0])


def line_map(
    polylines: list[np.ndarray],
    kinds: list[int],
    sd_m: float = 0.05,
    styles: list[int] | None = None,
) -> LineMap:
    n = len(polylines)
    vertices = np.concatenate(polylines)
    return LineMap(
        frame=EarthFrame("local", name="street"),
        vertices_m=vertices + ORIGIN_M,
        vertex_sd_m=np.full(len(vertices), sd_m),
        ids=np.arange(n) + 10,
        kind=np.array(kinds, dtype=np.int8),
        style=np.array(styles or [0] * n, dtype=np.int8),
        count=np.array([len(one) for one in polylines]),
        observations=np.ones(n, dtype=np.int64),
        drives=np.ones(n, dtype=np.int64),
        existence=np.full(n, 0.9),
    )


def bent_street() -> LineMap:
    """Three markings and a kerb that bend to the left; one marking ends where cars may be."""
    way = np.arange(-60.0, 61.0, 6.0)
    polylines = []
    for left in (-1.75, 1.75, 5.25, -2.6):
        radius = 120.0 - left
        polylines.append(
            np.stack([radius * np.sin(way / 120.0), 120.0 - radius * np.cos(way / 120.0)], axis=1)
        )
    polylines[2] = polylines[2][:12]
    return line_map(polylines, [MARKING, MARKING, MARKING, KERB], styles=[1, 2, 1, 0])


def pieces_of(rng: np.random.Generator) -> LineDetections:
    lefts = np.array([-1.8, 1.7, 5.2, -2.5, 0.4])
    start = np.column_stack([np.full(5, 5.0), lefts])
    end = np.column_stack([np.full(5, 11.0), lefts + rng.normal(0.3, 0.1, 5)])
    made = line_detections(
        MARKING, start, end, np.full(5, 0.08), np.full(5, 0.012), probability=np.full(5, 0.9)
    )
    kind = made.kind.copy()
    kind[3] = KERB
    return made.with_columns(kind=kind, style=np.array([1, 1, 0, 0, 2], dtype=np.int8))


def slow(pose: np.ndarray, lines: LineDetections, street: LineMap) -> float:
    """The formula, pair by pair, with every part of every line."""
    parts = street.segments
    total = 0.0
    for z in range(len(lines)):
        model = KIND_MODELS[int(lines.kind[z])]
        right = min(max(lines.probability[z] * (1.0 - model.clutter_share), 0.01), 0.99)
        x, y = lines.middle_vehicle_m[z]
        c, s_ = cos(pose[2]), sin(pose[2])
        place = pose[:2] + np.array([c * x - s_ * y, s_ * x + c * y])
        seen_m2 = lines.offset_sd_m[z] ** 2 + model.floor_m**2
        seen_rad2 = lines.direction_sd_rad[z] ** 2 + model.floor_rad**2
        spans = model.span_m * model.span_rad / (2.0 * pi)
        best, known = 0.0, False
        for s in range(len(parts)):
            if parts.kind[s] != lines.kind[z]:
                continue
            way = parts.end_m[s] - parts.start_m[s]
            length = float(np.hypot(*way))
            along = way / length
            dx, dy = place - parts.start_m[s]
            station = dx * along[0] + dy * along[1]
            across = dy * along[0] - dx * along[1]
            first = s == 0 or parts.line[s - 1] != parts.line[s]
            last = s + 1 == len(parts) or parts.line[s + 1] != parts.line[s]
            known |= abs(across) <= KNOWN_M and 0.0 <= station <= length
            if station < (0.0 if first else -1.0) or station > length + (0.0 if last else 1.0):
                continue
            known |= abs(across) <= KNOWN_M
            turn = lines.direction_rad[z] + pose[2] - np.arctan2(along[1], along[0])
            turn = (turn + pi / 2) % pi - pi / 2
            variance = seen_m2 + parts.sd_m[s] ** 2
            variance_rad2 = seen_rad2 + (parts.sd_m[s] / max(length, 5.0)) ** 2
            value = right * spans * parts.existence[s] / np.sqrt(variance * variance_rad2)
            if lines.style[z] != LineStyle.UNKNOWN and parts.style[s] != LineStyle.UNKNOWN:
                value *= 1.6 if lines.style[z] == parts.style[s] else 0.4
            value *= exp(-0.5 * across**2 / variance - 0.5 * turn**2 / variance_rad2)
            best = max(best, value)
        if known:
            total += log(1.0 - right + best)
        else:
            total += log(1.0 - right + right * spans / np.sqrt(seen_m2 * seen_rad2) * exp(-1.0))
    return total


@pytest.mark.parametrize(("spread_m", "spread_rad"), [(0.2, 0.01), (1.5, 0.05), (6.0, 0.3)])
def test_the_fast_model_is_the_slow_one(spread_m: float, spread_rad: float) -> None:
    rng = np.random.default_rng(3)
    street, lines = bent_street(), pieces_of(rng)
    centres = [np.array([0.0, 0.0, 0.0]), np.array([4.0, 0.2, 0.03]), np.array([-40.0, 8.0, 2.8])]
    for centre in centres:
        poses = centre + rng.standard_normal((60, 3)) * [2.0 * spread_m, spread_m, spread_rad]
        poses[:, :2] += ORIGIN_M
        near = LineIndex(street).near(poses[0, :2], 200.0)
        fast = line_log_likelihood(poses, Pieces.of(lines), near, Spread.of(poses))
        # pairs beyond five deviations count for nothing beside clutter
        np.testing.assert_allclose(fast, [slow(p, lines, street) for p in poses], atol=0.02)


def test_scattered_poses_are_weighed_as_each_alone() -> None:
    rng = np.random.default_rng(4)
    street, lines = bent_street(), pieces_of(rng)
    poses = rng.standard_normal((50, 3)) * [15.0, 5.0, 1.0]
    poses[:, :2] += ORIGIN_M
    weigher, away = LineWeigher(street), np.array([90.0, 90.0, 0.0])
    alone = [weigher.weigh(np.vstack([p, p + away]), lines)[0] for p in poses]
    np.testing.assert_allclose(weigher.weigh(poses, lines), alone, atol=1e-3)


def test_along_the_line_nothing_is_said_and_nothing_beyond_its_end_matches() -> None:
    """On a straight line the likelihood is level; past its end it is that of an unknown place."""
    street = line_map([np.array([[0.0, 1.75], [30.0, 1.75], [60.0, 1.75]])], [MARKING])
    lines = line_detections(
        MARKING,
        np.array([[5.0, 1.75]]),
        np.array([[11.0, 1.75]]),
        np.array([0.1]),
        np.array([0.01]),
    )
    east = np.arange(-20.25, 80.0, 0.5)
    poses = np.column_stack([east + ORIGIN_M[0], np.full(len(east), ORIGIN_M[1]), 0.0 * east])
    weigher = LineWeigher(street)
    value = weigher.weigh(poses, lines)
    middle = east + 8.0
    on = (middle > 0.0) & (middle < 60.0)
    assert np.ptp(value[on]) < 1e-9
    # a right piece is worth one unit less than a perfect one in the mean
    assert np.ptp(value[~on]) < 1e-9
    assert value[on][0] - value[~on][0] == pytest.approx(1.0, abs=0.3)
    assert len(weigher.match(poses[on][20], lines)) == 1
    assert len(weigher.match(poses[~on][-1], lines)) == 0
    aside = poses[on] + [0.0, 0.8, 0.0]
    assert (weigher.weigh(aside, lines) < value[~on][0] - 2.0).all()


def test_a_line_that_is_not_seen_costs_a_wide_set_a_little() -> None:
    street = line_map([np.array([[0.0, y], [60.0, y]]) for y in (1.75, -1.75)], [MARKING] * 2)
    lines = line_detections(
        MARKING,
        np.array([[5.0, 1.75]]),
        np.array([[11.0, 1.75]]),
        np.array([0.1]),
        np.array([0.01]),
    )
    # in its lane, and a lane to the right, where both lines lie to the left
    poses = np.array([[20.0, 0.0, 0.0], [20.0, 3.5, 0.0]]) + np.array([*ORIGIN_M, 0.0])
    near = LineIndex(street).near(ORIGIN_M, 100.0)
    alone = Spread.of(poses[:1])
    plain = line_log_likelihood(poses[:1], Pieces.of(lines), near, alone)
    charged = line_log_likelihood(poses[:1], Pieces.of(lines), near, alone, count_misses=True)
    assert charged[0] - plain[0] == pytest.approx(np.log1p(-0.4 * 0.9))


def test_pieces_of_one_frame_count_less_than_as_many_frames() -> None:
    assert frame_share(1) == 1.0
    assert 1.0 < 6 * frame_share(6) < 2.0
