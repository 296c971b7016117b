"""Lines of a map from pieces that drives saw: where they lie, what is one line, what is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.build.assemble import assemble_map
from polemap.build.city.io import observation_arrays, observations_of
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations, observe_drive
from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections, line_detections
from polemap.drivelog.streams import ReferenceStream
from polemap.map.line_map import LineMap
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import inverse_transform_points, rotate, wrap_angle

Floats = NDArray[np.float64]

CONFIG = MappingConfig()
FRAME = EarthFrame("utm", 32633)
ORIGIN = np.array([500_000.0, 5_400_000.0])
VIEW = VisibleRegion(np.zeros(2), -1.0, 1.0, 2.0, np.array([30.0]))
RADIUS_M = 60.0


def on_arc(way_m: Floats, left_m: float) -> Floats:
    """Points beside a street that turns left with `RADIUS_M`."""
    angle = np.asarray(way_m) / RADIUS_M
    reach = RADIUS_M - left_m
    return ORIGIN + np.column_stack([reach * np.sin(angle), RADIUS_M - reach * np.cos(angle)])


def pieces_from(
    pose: Floats, way_m: float, rng: np.random.Generator, offsets: dict[float, int], dashed: bool
) -> LineDetections:
    """Pieces of 4 m of lines beside the way, 4 to 12 m ahead, with errors of 4 cm and .01 rad."""
    parts = []
    for left_m, kind in offsets.items():
        for ahead in (4.0, 8.0):
            ends = np.array([way_m + ahead, way_m + ahead + 4.0])
            if dashed and kind == LandmarkKind.LANE_MARKING and (ends[0] // 6.0) % 2:
                continue
            local = inverse_transform_points(pose, on_arc(ends, left_m))
            normal = np.array([-1.0, 1.0]) * (local[1] - local[0])[::-1] / 4.0
            # a piece is fitted to its part of the arc, so it lies a third of the sagitta outside
            fitted = -(4.0**2) / (12.0 * (RADIUS_M - left_m))
            shift = fitted + 0.04 * rng.standard_normal()
            lean = 0.01 * rng.standard_normal() * 2.0
            local = local + normal * np.array([[shift - lean], [shift + lean]])
            style = LineStyle.DASHED if dashed else LineStyle.SOLID
            parts.append(
                line_detections(
                    kind, local[:1], local[1:], np.array([0.04]), np.array([0.01]),
                    style=style if kind == LandmarkKind.LANE_MARKING else LineStyle.UNKNOWN,
                )
            )  # fmt: skip
    return LineDetections.concatenate([LineDetections.none(), *parts])


def drive(
    name: str,
    start_s: float,
    seed: int,
    offsets: dict[float, int],
    *,
    dashed: bool = False,
    shift_m: float = 0.0,
) -> DriveObservations:
    rng = np.random.default_rng(seed)
    stamps = start_s + 0.1 * np.arange(100)
    way = 0.8 * np.arange(100)
    poses = np.column_stack([on_arc(way, shift_m), way / RADIUS_M])
    truth = np.column_stack([on_arc(way, 0.0), way / RADIUS_M])
    scans: list[Detections] = []
    for pose, at, stamp in zip(truth, way, stamps.tolist(), strict=True):
        none = pole_detections(stamp, stamp, np.empty((0, 2)), np.empty((0, 2, 2)), view=VIEW)
        scans.append(replace(none, lines=pieces_from(pose, float(at), rng, offsets, dashed)))
    reference = ReferenceStream(stamp_s=stamps, poses=poses, sd_m=np.full(100, 0.03))
    return observe_drive(name, FRAME, scans, reference, CONFIG, FRAME)


STREET = {-1.75: int(LandmarkKind.LANE_MARKING), 1.75: int(LandmarkKind.LANE_MARKING),
          -3.5: int(LandmarkKind.KERB)}  # fmt: skip


def lines_of(*drives: DriveObservations, update: PoleMap | None = None) -> LineMap:
    built = assemble_map(drives, CONFIG, FRAME, update=update).pole_map
    assert built.lines is not None
    return built.lines


def errors(lines: LineMap, row: int, left_m: float) -> Floats:
    """Of the vertices of a line across the true one."""
    centre = ORIGIN + np.array([0.0, RADIUS_M])
    return np.hypot(*(lines.polyline_m(row) - centre).T) - (RADIUS_M - left_m)


def row_at(lines: LineMap, left_m: float) -> int:
    medians = [abs(np.median(errors(lines, row, left_m))) for row in range(len(lines))]
    return int(np.argmin(medians))


def test_each_line_becomes_one_polyline_where_it_lies() -> None:
    lines = lines_of(drive("monday", 0.0, 1, STREET), drive("friday", 1e5, 2, STREET))
    assert sorted(lines.kind.tolist()) == [2, 2, 3]
    for left_m, kind in STREET.items():
        row = row_at(lines, left_m)
        assert lines.kind[row] == kind
        assert lines.drives[row] == 2
        assert lines.existence[row] > 0.95
        error = errors(lines, row, left_m)
        assert np.abs(error).max() < 0.08
        # nearly all the way that was seen: 4 m ahead of the start to 12 m ahead of the end
        length = np.hypot(*np.diff(lines.polyline_m(row), axis=0).T).sum()
        assert length > 0.85 * 87.0 * (RADIUS_M - left_m) / RADIUS_M


def test_stated_deviations_hold_over_references_that_err() -> None:
    rng = np.random.default_rng(5)
    squares = []
    for seed in range(8):
        shifts = 0.03 * rng.standard_normal(2)
        lines = lines_of(
            *(
                drive(f"d{number}", 1e5 * number, 10 * seed + number, STREET, shift_m=shift)
                for number, shift in enumerate(shifts.tolist())
            )
        )
        for left_m in STREET:
            row = row_at(lines, left_m)
            end = int(lines.count[: row + 1].sum())
            sd = lines.vertex_sd_m[end - int(lines.count[row]) : end]
            squares.append(float(np.mean((errors(lines, row, left_m) / sd) ** 2)))
    # a detector whose errors are free is stated as one whose errors last by half: cautious
    assert 0.1 < np.mean(squares) < 1.2


def test_dashes_are_one_dashed_line() -> None:
    lines = lines_of(drive("monday", 0.0, 3, STREET, dashed=True))
    marks = np.flatnonzero(lines.kind == LandmarkKind.LANE_MARKING)
    assert len(marks) == 2
    assert lines.style[marks].tolist() == [LineStyle.DASHED] * 2


def test_order_of_drives_and_a_checkpoint_change_nothing() -> None:
    parts = [drive("monday", 0.0, 1, STREET), drive("friday", 1e5, 2, STREET)]
    one = lines_of(*parts)
    again = [observations_of(*observation_arrays(part)) for part in reversed(parts)]
    two = lines_of(*again)
    np.testing.assert_array_equal(one.vertices_m, two.vertices_m)
    np.testing.assert_array_equal(one.existence, two.existence)


def test_what_was_seen_once_is_no_line() -> None:
    part = drive("monday", 0.0, 1, STREET)
    assert part.lines is not None
    few = replace(part, lines=part.lines.take(slice(0, 6)))
    assert len(lines_of(few)) == 0


def test_an_update_keeps_ids_and_forgets_what_was_painted_over() -> None:
    first = assemble_map([drive("monday", 0.0, 1, STREET)], CONFIG, FRAME).pole_map
    moved = {-3.5: int(LandmarkKind.KERB), 1.75: int(LandmarkKind.LANE_MARKING),
             -0.5: int(LandmarkKind.LANE_MARKING)}  # fmt: skip
    again = lines_of(drive("june", 1e6, 2, moved), drive("july", 2e6, 3, moved), update=first)
    assert first.lines is not None
    for left_m in (-3.5, 1.75):
        old, new = row_at(first.lines, left_m), row_at(again, left_m)
        assert again.ids[new] == first.lines.ids[old]
    painted = [float(np.median(errors(again, row, -1.75))) for row in range(len(again))]
    assert np.abs(painted).min() > 0.3
    fresh = row_at(again, -0.5)
    assert again.ids[fresh] not in first.lines.ids


def test_a_map_without_lines_has_none() -> None:
    part = replace(drive("monday", 0.0, 1, STREET), lines=None)
    assert assemble_map([part], CONFIG, FRAME).pole_map.lines is None


@pytest.mark.parametrize("turn_rad", [0.0, 2.0])
def test_the_free_side_of_a_corner_reaches_the_map(turn_rad: float) -> None:
    stamps = 0.1 * np.arange(40)
    forward = rotate(np.column_stack([0.2 * np.arange(40), np.zeros(40)]), turn_rad)
    poses = np.column_stack([ORIGIN + forward, np.full(40, turn_rad)])
    corner = ORIGIN + rotate(np.array([20.0, 6.0]), turn_rad)
    facing = turn_rad - 2.0
    scans = []
    for pose, stamp in zip(poses, stamps.tolist(), strict=True):
        seen = pole_detections(
            stamp, stamp, inverse_transform_points(pose, corner[None]), 1e-3 * np.eye(2)[None],
            view=VIEW,
        )  # fmt: skip
        scans.append(
            seen.with_columns(
                kind=np.array([LandmarkKind.CORNER], dtype=np.int8),
                facing_rad=np.array([wrap_angle(facing - turn_rad)]),
            )
        )
    reference = ReferenceStream(stamp_s=stamps, poses=poses, sd_m=np.full(40, 0.03))
    part = observe_drive("monday", FRAME, scans, reference, CONFIG, FRAME)
    built = assemble_map([part], CONFIG, FRAME).pole_map
    assert wrap_angle(built.extra["facing_rad"] - facing) == pytest.approx([0.0], abs=1e-9)
    later = replace(part, detections=replace(part.detections, drive="friday"))
    again = assemble_map([later], CONFIG, FRAME, update=built).pole_map
    assert wrap_angle(again.extra["facing_rad"] - facing) == pytest.approx([0.0], abs=1e-9)
