"""Mistakes in a part of a drive, and of axes and frames, are told as what they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.folder import write_drive
from polemap.vehicle.pose import rotate
from tests.drivelog.plausibility.made import (
    clean_drive,
    with_gnss,
    with_odometry,
    with_points,
    with_reference,
)

ROUND_S = 40.0


@pytest.fixture(scope="module")
def clean() -> Drive:
    return clean_drive(0)


@pytest.fixture(scope="module")
def laps() -> Drive:
    """Two rounds of one course: with a damaged part, a round earlier fits as well."""
    drive = clean_drive(0, ROUND_S)
    odometry, reference, gnss = drive.odometry, drive.reference, drive.gnss
    assert odometry is not None
    assert reference is not None
    assert gnss is not None

    def twice(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, values])

    def later(stamps: np.ndarray) -> np.ndarray:
        return np.concatenate([stamps, stamps + ROUND_S])

    # the way back to the start is cut out: its place jumps by less than a metre
    way = reference.poses[-1, :2] - reference.poses[0, :2]
    back = way * np.linspace(0.0, 1.0, len(reference))[:, None]
    poses = reference.poses - np.column_stack([back, np.zeros(len(back))])
    step = np.diff(poses[:, :2], axis=0, append=poses[:1, :2])
    poses[:, 2] = np.arctan2(step[:, 1], step[:, 0])
    closing = np.angle(np.exp(1j * np.diff(poses[:, 2], append=poses[0, 2])))
    rate = np.clip(closing / 0.02, -0.9, 0.9)
    rows = np.searchsorted(reference.stamp_s, gnss.stamp_s)
    fixes = poses[np.minimum(rows, len(poses) - 1), :2]
    return replace(
        drive,
        odometry=replace(
            odometry,
            stamp_s=later(odometry.stamp_s),
            arrival_s=later(odometry.arrival_s),
            speed_mps=twice(np.hypot(*step.T) / 0.02),
            yaw_rate_radps=twice(rate),
            lateral_mps=twice(odometry.lateral_mps),
        ),
        reference=replace(
            reference, stamp_s=later(reference.stamp_s), poses=twice(poses),
            sd_m=twice(reference.sd_m),
        ),
        gnss=replace(
            gnss, stamp_s=later(gnss.stamp_s), arrival_s=later(gnss.arrival_s),
            east_m=twice(fixes[:, 0]), north_m=twice(fixes[:, 1]), hdop=twice(gnss.hdop),
        ),
        scans=(),
    )  # fmt: skip


def kinds(drive: Drive) -> set[tuple[str, str, str]]:
    return {(f.kind, f.stream, f.severity) for f in check_drive(drive)}


def _held(values: np.ndarray, first: int, last: int) -> np.ndarray:
    held = values.copy()
    held[first:last] = held[first]
    return held


def _stuck(drive: Drive) -> Drive:
    return with_odometry(drive, yaw_rate_radps=_held(drive.odometry.yaw_rate_radps, 1200, 2000))


def _poses(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Drive], Drive]:
    return lambda d: with_reference(d, poses=change(d.reference.poses.copy()))


def _jump(poses: np.ndarray) -> np.ndarray:
    poses[2000:, 0] += 3.0
    return poses


def _far(poses: np.ndarray) -> np.ndarray:
    poses[2000:2300, :2] += 3e5
    return poses


def _summed(poses: np.ndarray) -> np.ndarray:
    way = np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T))
    poses[:, 1] += 0.03 * way
    return poses


def _thinned(drive: Drive) -> Drive:
    reference = drive.reference
    thin = {name: getattr(reference, name)[::150] for name in ("stamp_s", "poses", "sd_m")}
    return replace(drive, reference=replace(reference, **thin))


def _cut(drive: Drive, rows: slice, scale: float = 1.0) -> Drive:
    odometry = drive.odometry
    cut = odometry.take(rows)
    stamps = {n: getattr(cut, n) * scale for n in ("stamp_s", "arrival_s")}
    return replace(drive, odometry=replace(cut, **stamps))


def _by_north(drive: Drive) -> Drive:
    """Poles that lie by the axes of the map, from the car."""
    yaw = np.interp(
        [s.stamp_s for s in drive.scans],
        drive.reference.stamp_s,
        np.unwrap(drive.reference.poses[:, 2]),
    )
    turned = iter(yaw)
    return with_points(drive, lambda points: rotate(points, next(turned)))


def _left_handed(drive: Drive) -> Drive:
    """East and north exchanged and the yaw from north, as of NED, where no fix tells."""
    poses = drive.reference.poses
    mirrored = np.column_stack([poses[:, 1], poses[:, 0], np.pi / 2 - poses[:, 2]])
    local = replace(drive, frame=EarthFrame("local", name="yard"), gnss=None)
    return with_reference(local, poses=mirrored)


ODOMETRY, REFERENCE, POLES = "odometry.csv", "reference.csv", "poles.csv"
MISTAKES: dict[str, tuple[Callable[[Drive], Drive], tuple[str, str, str]]] = {
    "a yaw rate that sticks": (_stuck, ("turn_stretch", ODOMETRY, "warning")),
    "position jumps": (_poses(_jump), ("reference_jump", REFERENCE, "warning")),
    "rows of another place": (_poses(_far), ("reference_jump", REFERENCE, "error")),
    "position held": (_poses(lambda p: _held(p, 2000, 2500)),
                      ("reference_jump", REFERENCE, "warning")),
    "summed-up reference": (_poses(_summed), ("reference_drift", REFERENCE, "warning")),
    "a pose every three seconds": (_thinned, ("reference_sparse", REFERENCE, "warning")),
    "odometry of half": (lambda d: _cut(d, slice(0, 2000)),
                         ("odometry_missing", ODOMETRY, "warning")),
    "odometry begins late": (lambda d: _cut(d, slice(1500, None)),
                             ("odometry_missing", ODOMETRY, "warning")),
    "odometry in minutes": (lambda d: _cut(d, slice(None), 1 / 60),
                            ("stamp_unit", ODOMETRY, "error")),
    "poles along east and north": (_by_north, ("pole_axes", POLES, "error")),
    "poles at twice the distance": (lambda d: with_points(d, lambda p: 2.0 * p),
                                    ("pole_speed", POLES, "error")),
    "poles at half the distance": (lambda d: with_points(d, lambda p: 0.5 * p),
                                   ("pole_speed", POLES, "error")),
    "reference of a left-handed frame": (_left_handed, ("reference_axes", REFERENCE, "error")),
}  # fmt: skip


@pytest.mark.parametrize("name", list(MISTAKES))
def test_a_mistake_is_told_as_what_it_is(clean: Drive, name: str) -> None:
    change, expected = MISTAKES[name]
    found = check_drive(change(clean))
    assert expected in {(f.kind, f.stream, f.severity) for f in found}, [f.line() for f in found]
    assert all(len(f.line()) < 300 for f in found)


def test_a_left_handed_reference_accuses_no_other_stream(clean: Drive) -> None:
    assert kinds(_left_handed(clean)) == {("reference_axes", REFERENCE, "error")}


def test_rounds_are_clean(laps: Drive) -> None:
    assert not {kind for kind, _, _ in kinds(laps)} & {"clock_offset", "turn_stretch"}


@pytest.mark.parametrize("part", ["odometry", "reference"])
def test_a_damaged_part_is_no_clock_that_is_a_round_off(laps: Drive, part: str) -> None:
    """The round without the damage fits the other one better than itself."""
    damaged = _stuck(laps) if part == "odometry" else _poses(lambda p: _held(p, 2500, 3000))(laps)
    found = kinds(damaged)
    assert found
    assert "clock_offset" not in {kind for kind, _, _ in found}


def test_poses_at_zero_are_left_out_and_said(clean: Drive, tmp_path: Path) -> None:
    short = clean_drive(0, 30.0)
    write_drive(_poses(lambda p: np.where(np.arange(len(p))[:, None] // 100 == 7, 0.0, p))(short),
                tmp_path / "d")  # fmt: skip
    drive = open_drive(tmp_path / "d")
    assert drive.problems["reference_at_zero"] == 100
    assert len(drive.reference) == len(short.reference) - 100
    assert ("reference_no_pose", REFERENCE, "warning") in kinds(drive)


def test_a_receiver_that_wanders_is_no_drift(clean: Drive) -> None:
    away = 15.0 * np.sin(np.pi * np.linspace(0.0, 1.0, len(clean.gnss)))
    assert "reference_drift" not in {
        kind for kind, _, _ in kinds(with_gnss(clean, east_m=clean.gnss.east_m + away))
    }
