"""Mistakes of parts: single rows, stretches, delays, the place of the pole detector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive, Lap
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import geographic_from_grid, grid_from_geographic
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.folder import write_drive
from polemap.vehicle.pose import rotate, rotate_back, wrap_angle
from tests.drivelog.plausibility.made import (
    clean_drive,
    late,
    with_gnss,
    with_odometry,
    with_points,
    with_reference,
)

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def clean() -> Drive:
    return clean_drive(0)


def _only(drive: Drive) -> Finding:
    (finding,) = check_drive(drive)
    return finding


# seed, duration, pace, bends: short, slow, straight and standing drives beside usual ones
KINDS = [
    (0, 80.0, 1.0, 1.0), (1, 80.0, 1.0, 1.0), (2, 240.0, 1.0, 1.0), (3, 80.0, 0.15, 1.0),
    (4, 80.0, 1.0, 0.0), (5, 80.0, 0.0, 0.0), (6, 6.0, 1.0, 1.0), (7, 1.0, 1.0, 1.0),
    (8, 80.0, 1.3, -1.0), (9, 30.0, 0.4, 2.0),
]  # fmt: skip


@pytest.mark.parametrize(("seed", "duration_s", "pace", "bends"), KINDS)
def test_clean_drives_of_every_kind_are_left_alone(
    seed: int, duration_s: float, pace: float, bends: float
) -> None:
    drive = clean_drive(seed, duration_s, pace, bends)
    assert check_drive(drive) == []
    assert check_drive(replace(drive, reference=None)) == []
    assert check_drive(replace(drive, gnss=None)) == []
    assert check_drive(replace(drive, odometry=None)) == []


@pytest.mark.parametrize("share", [0.75, 0.5, 0.2])
def test_fixes_that_come_now_and_then_are_no_mistake(clean: Drive, share: float) -> None:
    kept = np.random.default_rng(0).random(len(clean.gnss)) < share
    assert check_drive(replace(clean, gnss=clean.gnss.take(kept))) == []


def test_a_speed_that_never_changes_is_no_speed(clean: Drive) -> None:
    still = with_odometry(clean, speed_mps=np.full(len(clean.odometry), 8.0))
    finding = _only(still)
    assert (finding.kind, finding.severity) == ("speed_frozen", "error")
    assert "goes at" in finding.value
    # a car that does keep its speed is believed
    assert check_drive(replace(still, reference=None, gnss=None, scans=())) == []


@pytest.mark.parametrize("stream", ["odometry", "reference"])
def test_a_stretch_that_sticks_is_noticed_and_its_stream_named(clean: Drive, stream: str) -> None:
    drive = clean_drive(0, 160.0)
    n = len(drive.odometry)
    part = slice(n // 2, n // 2 + 1500)
    if stream == "odometry":
        speed = drive.odometry.speed_mps.copy()
        speed[part] *= 3.6
        drive = with_odometry(drive, speed_mps=speed)
    else:
        poses = drive.reference.poses.copy()
        poses[part] = poses[part.start]
        drive = with_reference(drive, poses=poses)
    found = [f for f in check_drive(drive) if f.kind == "speed_stretch"]
    assert [f.stream for f in found] == [f"{stream}.csv"]
    assert "stretches of 10 s" in found[0].value


def test_a_yaw_rate_with_an_offset_is_noticed(clean: Drive) -> None:
    turned = with_odometry(clean, yaw_rate_radps=clean.odometry.yaw_rate_radps + 0.05)
    finding = _only(turned)
    assert finding.kind == "yaw_rate_offset"
    assert "0.05" in finding.value


def test_a_fix_that_stands_for_others_is_noticed(clean: Drive) -> None:
    east, north = clean.gnss.east_m.copy(), clean.gnss.north_m.copy()
    east[40:80], north[40:80] = east[40], north[40]
    found = check_drive(with_gnss(clean, east_m=east, north_m=north))
    assert "gnss_frozen" in [f.kind for f in found]


@pytest.mark.parametrize("late_s", [0.5, -0.5, 0.8])
@pytest.mark.parametrize("reference", [True, False])
def test_fixes_half_a_second_late_are_noticed(clean: Drive, late_s: float, reference: bool) -> None:
    drive = late(clean if reference else replace(clean, reference=None), "gnss", late_s)
    found = [f for f in check_drive(drive) if f.kind == "clock_offset"]
    assert [(f.stream, f.severity) for f in found] == [("gnss.csv", "warning")]
    assert ("subtract" if late_s > 0 else "add") in found[0].remedy


def test_a_round_earlier_is_no_other_clock() -> None:
    """On laps, the motion of the fixes fits a lag of a lap as well; their places do not."""
    t = np.arange(0.0, 120.0, 0.02)
    drive = clean_drive(0, 120.0)
    rate = np.full(len(t), 2 * np.pi / 30.0)
    speed = 8.0 + 3.0 * np.sin(2 * np.pi * t / 15.0)
    yaw = np.cumsum(rate) * 0.02
    east = 388_500.0 + np.cumsum(speed * np.cos(yaw)) * 0.02
    north = 5_819_500.0 + np.cumsum(speed * np.sin(yaw)) * 0.02
    poses = np.column_stack([east, north, wrap_angle(yaw)])
    drive = with_odometry(drive, speed_mps=speed, yaw_rate_radps=rate)
    drive = replace(with_reference(drive, poses=poses), scans=())
    rows = np.searchsorted(t, drive.gnss.stamp_s)
    rng = np.random.default_rng(0)
    noise = 0.3 * rng.standard_normal((len(rows), 2))
    for kept in (slice(None), rng.random(len(rows)) < 0.6):
        lapped = with_gnss(
            drive, east_m=east[rows] + noise[:, 0], north_m=north[rows] + noise[:, 1]
        )
        lapped = replace(lapped, gnss=lapped.gnss.take(np.arange(len(rows))[kept]))
        assert check_drive(lapped) == []


@pytest.mark.parametrize(
    ("x_m", "y_m", "yaw_deg", "said"),
    [
        (1.5, 0.0, 0.0, "m ahead of the rear axle"),
        (-1.5, 0.0, 0.0, "m behind the rear axle"),
        (0.0, 1.0, 0.0, "m left of the rear axle"),
        (0.0, 0.0, 5.0, "turned by 5."),
    ],
)
@pytest.mark.parametrize("reference", [True, False])
def test_a_detector_mounted_elsewhere_is_noticed(
    clean: Drive, x_m: float, y_m: float, yaw_deg: float, said: str, reference: bool
) -> None:
    scale = 1.0 if reference else 2.5
    place, yaw = scale * np.array([x_m, y_m]), scale * np.radians(yaw_deg)
    moved = with_points(clean, lambda points: rotate_back(points - place, yaw))
    if not reference:
        moved, said = replace(moved, reference=None), said.replace("5.", "12.")
    found = _only(moved)
    assert found.kind == "pole_mounting"
    assert said in found.value


@pytest.mark.parametrize("reference", [True, False])
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_distances_that_are_a_tenth_off_are_noticed(
    clean: Drive, factor: float, reference: bool
) -> None:
    scaled = with_points(clean, lambda points: factor * points)
    if not reference:
        scaled = replace(scaled, reference=None)
    found = _only(scaled)
    assert (found.kind, found.stream) == ("pole_scale", "poles.csv")
    assert f"move {factor:.1f}" in found.value.replace("0.89", "0.90").replace("1.09", "1.10")
    assert ("multiply x and y" in found.remedy) == reference


@pytest.mark.parametrize("streams", [(), ("reference",), ("reference", "gnss")])
@pytest.mark.parametrize("factor", [2.0, 0.5, 1.3])
def test_an_axis_of_another_scale_is_noticed(
    clean: Drive, factor: float, streams: tuple[str, ...]
) -> None:
    scaled = with_points(clean, lambda points: points * [1.0, factor])
    found = _only(replace(scaled, **dict.fromkeys(streams)))
    assert (found.kind, found.stream) == ("pole_axes", "poles.csv")
    assert f"{factor:.1f}" in found.value


def _polar(unit_rad: float) -> Callable[[Floats], Floats]:
    return lambda points: np.stack(
        [np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0]) / unit_rad], axis=1
    )


def _by_map(drive: Drive) -> Drive:
    poses = drive.reference.at([scan.stamp_s for scan in drive.scans], max_gap_s=1.0)
    scans = [
        replace(scan, points_vehicle_m=rotate(scan.points_vehicle_m, pose[2]))
        for scan, pose in zip(drive.scans, poses, strict=True)
    ]
    return replace(drive, scans=tuple(scans))


def _repeated(drive: Drive) -> Drive:
    first = drive.scans[20]
    return replace(
        drive,
        scans=tuple(replace(first, stamp_s=s.stamp_s, arrival_s=s.arrival_s) for s in drive.scans),
    )


# poles and odometry alone: what is done, kind, stream, words of the value or of the remedy
ALONE: dict[str, tuple[Callable[[Drive], Drive], str, str, str]] = {
    "ranges and degrees": (lambda d: with_points(d, _polar(np.pi / 180)), "pole_polar",
                           "poles.csv", "degrees"),
    "ranges and radians": (lambda d: with_points(d, _polar(1.0)), "pole_polar", "poles.csv",
                           "rad)"),
    "axes of the map": (_by_map, "pole_axes", "poles.csv", "east and north"),
    "one scan for all": (_repeated, "pole_repeated", "poles.csv", "anew"),
    "a yaw rate 0.05 rad/s too large": (
        lambda d: with_odometry(d, yaw_rate_radps=d.odometry.yaw_rate_radps + 0.05),
        "yaw_rate_offset", "odometry.csv", "standing still"),
    "a yaw rate 30 % too large": (
        lambda d: with_odometry(d, yaw_rate_radps=d.odometry.yaw_rate_radps * 1.3),
        "yaw_rate_scale", "odometry.csv", "0.7"),
    "no yaw rate": (lambda d: with_odometry(d, yaw_rate_radps=0.0 * d.odometry.yaw_rate_radps),
                    "yaw_rate_frozen", "odometry.csv", "measured"),
    "no speed": (lambda d: with_odometry(d, speed_mps=0.0 * d.odometry.speed_mps),
                 "speed_frozen", "odometry.csv", "turns at"),
    "a speed 20 % too small": (
        lambda d: with_odometry(d, speed_mps=d.odometry.speed_mps / 1.2), "pole_scale",
        "poles.csv", "wheel radius of odometry.csv"),
}  # fmt: skip


@pytest.mark.parametrize("name", ALONE)
def test_poles_and_odometry_alone_tell_the_mistake(clean: Drive, name: str) -> None:
    change, kind, stream, words = ALONE[name]
    alone = replace(change(clean), reference=None, gnss=None)
    found = next(f for f in check_drive(alone) if f.severity != "note")
    assert (found.kind, found.stream) == (kind, stream)
    assert words in f"{found.value} {found.expected} {found.remedy}"


def test_a_common_offset_of_a_gyro_is_no_mistake(clean: Drive) -> None:
    rate = clean.odometry.yaw_rate_radps + 0.008
    alone = replace(with_odometry(clean, yaw_rate_radps=rate), reference=None, gnss=None)
    assert check_drive(alone) == []


def test_fixes_in_radians_are_told(clean: Drive) -> None:
    places = np.stack([clean.gnss.east_m, clean.gnss.north_m], axis=1)
    radians = np.radians(geographic_from_grid(clean.frame, places))
    east, north = grid_from_geographic(clean.frame, *radians.T).T
    found = check_drive(with_gnss(clean, east_m=east, north_m=north))
    assert ("gnss_axes", "in degrees") in [(f.kind, f.remedy[-10:]) for f in found]


def test_stamps_in_minutes_are_told(clean: Drive) -> None:
    stamps = clean.reference.stamp_s / 60.0
    found = check_drive(replace(with_reference(clean, stamp_s=stamps), odometry=None, gnss=None))
    assert "stamp_unit" in {f.kind for f in found}


def test_fixes_that_stick_do_not_accuse_the_odometry(clean: Drive) -> None:
    held = np.minimum(np.arange(len(clean.gnss)), 60)
    stuck = with_gnss(clean, east_m=clean.gnss.east_m[held], north_m=clean.gnss.north_m[held])
    assert _only(replace(stuck, reference=None)).kind == "gnss_frozen"


def test_a_clock_that_is_off_is_its_streams(clean: Drive) -> None:
    """Fixes are metres off: they do not tell 0.3 s of reference from none."""
    for seed in range(3):
        drive = clean_drive(seed)
        rng = np.random.default_rng(seed)
        east = drive.gnss.east_m + 2.0 * rng.standard_normal(len(drive.gnss))
        found = _only(late(with_gnss(drive, east_m=east), "reference", 0.3))
        assert (found.kind, found.stream) == ("clock_offset", "reference.csv")


@pytest.mark.parametrize("degrees", [1.3, -1.3, 3.0])
def test_a_small_constant_in_the_yaw_is_noticed(clean: Drive, degrees: float) -> None:
    poses = clean.reference.poses.copy()
    poses[:, 2] = wrap_angle(poses[:, 2] + np.radians(degrees))
    found = [f for f in check_drive(with_reference(clean, poses=poses)) if f.stream[:3] == "ref"]
    assert [f.kind for f in found] == ["reference_yaw"]
    # the grid of the drive is turned by 1.3 degrees against the north
    assert ("geographic" in found[0].remedy) == (abs(degrees) == 1.3)


@pytest.mark.parametrize(
    ("late_s", "severity"), [(0.3, None), (1.5, "warning"), (60.0, "error"), (55.0, "error")]
)
@pytest.mark.parametrize("stream", ["odometry", "gnss", "poles"])
def test_rows_that_arrive_long_after_their_stamp(
    clean: Drive, stream: str, late_s: float, severity: str | None
) -> None:
    if stream == "poles":
        moved = tuple(replace(scan, arrival_s=scan.stamp_s + late_s) for scan in clean.scans)
        drive = replace(clean, scans=moved)
    else:
        given = getattr(clean, stream)
        drive = replace(clean, **{stream: replace(given, arrival_s=given.stamp_s + late_s)})
    found = check_drive(drive)
    assert [(f.kind, f.severity) for f in found] == ([("arrival", severity)] if severity else [])


@pytest.mark.parametrize(
    ("start_s", "end_s", "severity"),
    [
        (0.0, 80.0, None),
        (0.0, 81.0, None),
        (-3.0, 90.0, None),
        (0.0, 1e6, "warning"),
        (0.0, 80_000.0, "error"),
        (9000.0, 9080.0, "error"),
    ],
)
def test_laps_outside_of_the_drive(
    clean: Drive, start_s: float, end_s: float, severity: str | None
) -> None:
    found = check_drive(replace(clean, laps=(Lap("one", start_s, end_s),)))
    assert [(f.kind, f.severity) for f in found] == ([("laps", severity)] if severity else [])
    assert all(("milliseconds" in f.value) == (end_s == 80_000.0) for f in found)


@pytest.mark.parametrize("stream", ["odometry", "gnss", "reference"])
@pytest.mark.parametrize("rows", [1, 2])
def test_files_of_a_row_or_two(clean: Drive, stream: str, rows: int) -> None:
    given = getattr(clean, stream)
    drive = replace(clean, **{stream: given.take(np.arange(rows))})
    found = check_drive(drive)
    assert [(f.kind, f.stream, f.severity) for f in found] == [
        ("few_rows", f"{stream}.csv", "warning")
    ]


@pytest.fixture
def folder(clean: Drive, tmp_path: Path) -> Path:
    write_drive(clean, tmp_path / "drive")
    return tmp_path / "drive"


def _column(path: Path, name: str, change) -> None:  # type: ignore[no-untyped-def]
    head, *rows = path.read_text().splitlines()
    names = head.split(",")
    table = [dict(zip(names, row.split(","), strict=True)) for row in rows]
    for number, row in enumerate(table):
        row[name] = str(change(number, row))
    names += [name] if name not in names else []
    body = [",".join(row[key] for key in names) for row in table]
    path.write_text("\n".join([",".join(names), *body]) + "\n")


def test_the_written_drive_is_clean(folder: Path) -> None:
    assert check_drive(open_drive(folder)) == []


@pytest.mark.parametrize("value", [0.0, -0.05, 50.0])
def test_a_stated_accuracy_that_is_none(folder: Path, value: float) -> None:
    _column(folder / "reference.csv", "sd_m", lambda _n, _row: value)
    drive = open_drive(folder)
    assert np.isnan(drive.reference.sd_m).all() == (value <= 0.0)
    assert [f.kind for f in check_drive(drive)] == ["reference_sd"]


@pytest.mark.parametrize("every", [4, 100])
def test_fixes_at_zero_are_left_out_and_said(folder: Path, every: int) -> None:
    for name in ("latitude_deg", "longitude_deg"):
        _column(folder / "gnss.csv", name, lambda n, row: 0 if n % every == 3 else row[name])  # noqa: B023
    drive = open_drive(folder)
    count = drive.problems["gnss_at_zero"]
    assert count == len(range(3, len(drive.gnss) + count, every))
    assert [f.kind for f in check_drive(drive)] == ["gnss_no_fix"]


def test_fixes_around_the_origin_of_a_local_frame_stay(tmp_path: Path) -> None:
    write_drive(clean_drive(0, 10.0), tmp_path / "d")
    text = (tmp_path / "d" / "drive.yaml").read_text()
    head = text.replace("kind: utm", "kind: local").replace("epsg: 32633", "name: yard")
    (tmp_path / "d" / "drive.yaml").write_text(head)
    (tmp_path / "d" / "gnss.csv").write_text(
        "stamp_s,east_m,north_m,hdop\n0,-9,0,1\n1,0,0,1\n2,9,0,1\n3,900,0,1\n4,0,0,1\n5,910,0,1\n"
    )
    drive = open_drive(tmp_path / "d")
    assert drive.gnss.east_m.tolist() == [-9, 0, 9, 900, 910]


@pytest.mark.parametrize("stream", ["odometry", "gnss", "poles"])
def test_rows_that_arrive_before_their_stamp_are_said(folder: Path, stream: str) -> None:
    path = folder / f"{stream}.csv"
    _column(path, "arrival_s", lambda _n, row: float(row["stamp_s"]) - 0.5)
    found = check_drive(open_drive(folder))
    assert [(f.kind, f.stream) for f in found] == [("arrival", f"{stream}.csv")]
    assert "before their stamp" in found[0].value
