"""Mistakes of the streams: each is noticed, its stream named, and clean drives are left alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import EarthFrame, geographic_from_grid, grid_from_geographic
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.pose import wrap_angle
from tests.drivelog.plausibility.made import (
    clean_drive,
    late,
    with_gnss,
    with_odometry,
    with_points,
    with_reference,
)


def _speed(factor: float) -> Callable[[Drive], Drive]:
    return lambda d: with_odometry(d, speed_mps=factor * d.odometry.speed_mps)


def _rate(factor: float) -> Callable[[Drive], Drive]:
    return lambda d: with_odometry(d, yaw_rate_radps=factor * d.odometry.yaw_rate_radps)


def _yaw(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Drive], Drive]:
    def made(drive: Drive) -> Drive:
        poses = drive.reference.poses.copy()
        poses[:, 2] = wrap_angle(change(poses[:, 2]))
        return with_reference(drive, poses=poses)

    return made


def _lever(ahead_m: float, left_m: float) -> Callable[[Drive], Drive]:
    def made(drive: Drive) -> Drive:
        poses = drive.reference.poses.copy()
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        poses[:, 0] += ahead_m * c - left_m * s
        poses[:, 1] += ahead_m * s + left_m * c
        return with_reference(drive, poses=poses)

    return made


def _places(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Drive], Drive]:
    def made(drive: Drive) -> Drive:
        poses = drive.reference.poses.copy()
        poses[:, :2] = change(poses[:, :2])
        return with_reference(drive, poses=poses)

    return made


def _turned(angle: float) -> Callable[[Drive], Drive]:
    def made(drive: Drive) -> Drive:
        poses = drive.reference.poses.copy()
        c, s = np.cos(angle), np.sin(angle)
        start = poses[0, :2].copy()
        poses[:, :2] = (poses[:, :2] - start) @ np.array([[c, s], [-s, c]]) + start
        poses[:, 2] = wrap_angle(poses[:, 2] + angle)
        return with_reference(drive, poses=poses)

    return made


def _rounded(drive: Drive, decimals: int) -> Drive:
    places = geographic_from_grid(
        drive.frame, np.stack([drive.gnss.east_m, drive.gnss.north_m], axis=1)
    )
    there = grid_from_geographic(drive.frame, *np.round(places, decimals).T)
    return with_gnss(drive, east_m=there[:, 0], north_m=there[:, 1])


def _held(drive: Drive, rows: int) -> Drive:
    measured = np.arange(len(drive.reference)) // rows * rows
    return with_reference(drive, poses=drive.reference.poses[measured])


def _all_stamps(factor: float) -> Callable[[Drive], Drive]:
    def made(d: Drive) -> Drive:
        return replace(
            d,
            odometry=replace(
                d.odometry,
                stamp_s=d.odometry.stamp_s * factor,
                arrival_s=d.odometry.arrival_s * factor,
            ),
            gnss=replace(
                d.gnss, stamp_s=d.gnss.stamp_s * factor, arrival_s=d.gnss.arrival_s * factor
            ),
            reference=replace(d.reference, stamp_s=d.reference.stamp_s * factor),
            scans=tuple(
                replace(s, stamp_s=s.stamp_s * factor, arrival_s=s.arrival_s * factor)
                for s in d.scans
            ),
        )

    return made


EAST_300_M, NORTH_40_M = np.array([300.0, 0.0]), np.array([0.0, 40.0])

# name: what is done to a clean drive, kind, stream and severity of what must be found
MISTAKES: dict[str, tuple[Callable[[Drive], Drive], str, str, str]] = {
    "speed in km/h": (_speed(3.6), "speed_unit", "odometry.csv", "error"),
    "speed in mph": (_speed(2.23694), "speed_unit", "odometry.csv", "error"),
    "speed in cm/s": (_speed(100.0), "speed_unit", "odometry.csv", "error"),
    "speed in knots": (_speed(1.94384), "speed_unit", "odometry.csv", "error"),
    "speed divided twice": (_speed(1 / 3.6), "speed_unit", "odometry.csv", "error"),
    "speed 17 % off": (_speed(1.17), "speed_scale", "odometry.csv", "warning"),
    "speed negative": (_speed(-1.0), "speed_sign", "odometry.csv", "error"),
    "speed zero": (_speed(0.0), "speed_sign", "odometry.csv", "error"),
    "yaw rate in degrees": (_rate(57.2958), "yaw_rate_unit", "odometry.csv", "error"),
    "yaw rate in mrad": (_rate(1000.0), "yaw_rate_unit", "odometry.csv", "error"),
    "yaw rate converted twice": (_rate(0.0174533), "yaw_rate_unit", "odometry.csv", "error"),
    "yaw rate clockwise": (_rate(-1.0), "yaw_rate_sign", "odometry.csv", "error"),
    "yaw rate zero": (_rate(0.0), "yaw_rate_scale", "odometry.csv", "error"),
    "yaw rate 35 % off": (_rate(1.35), "yaw_rate_scale", "odometry.csv", "warning"),
    "odometry late": (lambda d: late(d, "odometry", 0.3), "clock_offset", "odometry.csv",
                      "warning"),
    "odometry early": (lambda d: late(d, "odometry", -0.5), "clock_offset", "odometry.csv",
                       "warning"),
    "reference late": (lambda d: late(d, "reference", 0.3), "clock_offset", "reference.csv",
                       "warning"),
    "reference a leap second late": (lambda d: late(d, "reference", 18.0), "clock_offset",
                                     "reference.csv", "error"),
    "fixes late": (lambda d: late(d, "gnss", 1.5), "clock_offset", "gnss.csv", "warning"),
    "fixes leap seconds early": (lambda d: late(d, "gnss", -18.0), "clock_offset", "gnss.csv",
                                 "error"),
    "poles late": (lambda d: late(d, "poles", 0.5), "clock_offset", "poles.csv", "warning"),
    "poles early": (lambda d: late(d, "poles", -0.5), "clock_offset", "poles.csv", "warning"),
    "poles seconds early": (lambda d: late(d, "poles", -5.0), "clock_offset", "poles.csv", "error"),
    "poles leap seconds late": (lambda d: late(d, "poles", 18.0), "clock_offset", "poles.csv",
                                "error"),
    "reference on the epoch": (lambda d: late(d, "reference", 1.7e9), "clock_apart",
                               "reference.csv", "error"),
    "odometry an hour off": (lambda d: late(d, "odometry", 3600.0), "clock_apart", "odometry.csv",
                             "error"),
    "all stamps in ms": (_all_stamps(1e3), "stamp_unit", "odometry.csv", "error"),
    "all stamps in us": (_all_stamps(1e6), "stamp_unit", "odometry.csv", "error"),
    "yaw from north": (_yaw(lambda y: np.pi / 2 - y), "reference_yaw", "reference.csv", "error"),
    "yaw from north, ccw": (_yaw(lambda y: y - np.pi / 2), "reference_yaw", "reference.csv",
                            "error"),
    "yaw clockwise": (_yaw(lambda y: -y), "reference_yaw", "reference.csv", "error"),
    "yaw backward": (_yaw(lambda y: y + np.pi), "reference_yaw", "reference.csv", "error"),
    "yaw 8 degrees off": (_yaw(lambda y: y + 0.14), "reference_yaw", "reference.csv", "warning"),
    "reference at the front axle": (_lever(2.7, 0.0), "reference_lever_arm", "reference.csv",
                                    "warning"),
    "reference at an antenna": (_lever(-0.9, 0.2), "reference_lever_arm", "reference.csv",
                                "warning"),
    "reference beside the car": (_lever(0.0, 1.2), "reference_lever_arm", "reference.csv",
                                 "warning"),
    "east and north exchanged": (_places(lambda p: p[:, ::-1]), "reference_axes", "reference.csv",
                                 "error"),
    "reference in km": (_places(lambda p: p / 1000.0), "reference_place", "reference.csv",
                        "error"),
    "reference with a local origin": (_places(lambda p: p - [388_400.0, 5_819_400.0]),
                                      "reference_place", "reference.csv", "error"),
    "reference 300 m off": (_places(lambda p: p + EAST_300_M), "gnss_reference",
                            "reference.csv", "error"),
    "reference 40 m off": (_places(lambda p: p + NORTH_40_M), "gnss_reference", "reference.csv",
                           "warning"),
    "reference turned": (_turned(np.radians(12.0)), "reference_rotation", "reference.csv",
                         "warning"),
    "poles with y to the right": (lambda d: with_points(d, lambda p: p * [1.0, -1.0]),
                                  "pole_turn", "poles.csv", "error"),
    "poles behind": (lambda d: with_points(d, lambda p: -p), "pole_direction", "poles.csv",
                     "error"),
    "poles with x and y exchanged": (lambda d: with_points(d, lambda p: p[:, ::-1]), "pole_axes",
                                     "poles.csv", "error"),
    "poles in the axes of a camera": (lambda d: with_points(d, lambda p: p[:, ::-1] * [-1.0, 1.0]),
                                      "pole_axes", "poles.csv", "error"),
    "poles turned to the left": (lambda d: with_points(d, lambda p: p[:, ::-1] * [1.0, -1.0]),
                                 "pole_axes", "poles.csv", "error"),
    "fixes with four decimals": (lambda d: _rounded(d, 4), "gnss_rounded", "gnss.csv", "warning"),
    "fixes with five decimals": (lambda d: _rounded(d, 5), "gnss_rounded", "gnss.csv", "warning"),
    "reference held": (lambda d: _held(d, 25), "reference_held", "reference.csv", "warning"),
    "poles in feet": (lambda d: with_points(d, lambda p: p / 0.3048), "pole_speed", "poles.csv",
                      "error"),
    "poles in mm": (lambda d: with_points(d, lambda p: p * 1000.0), "pole_range", "poles.csv",
                    "error"),
    "dilution of an accuracy": (lambda d: with_gnss(d, hdop=np.full(len(d.gnss), 99.99)), "hdop",
                                "gnss.csv", "warning"),
    "fixes frozen": (lambda d: with_gnss(d, east_m=0 * d.gnss.east_m + d.gnss.east_m[0],
                                         north_m=0 * d.gnss.north_m + d.gnss.north_m[0]),
                     "gnss_frozen", "gnss.csv", "warning"),
    "wheelbase in mm": (lambda d: replace(d, wheelbase_m=2700.0), "wheelbase", "drive.yaml",
                        "error"),
    "antenna in mm": (lambda d: replace(d, gnss_antenna_m=np.array([400.0, 0.0])), "gnss_antenna",
                      "drive.yaml", "error"),
    "wrong zone": (lambda d: replace(d, frame=EarthFrame("utm", 32634)), "zone", "drive.yaml",
                   "error"),
}  # fmt: skip


@pytest.fixture(scope="module")
def clean() -> Drive:
    return clean_drive(0)


def found(drive: Drive, kind: str, stream: str) -> Finding:
    findings = check_drive(drive)
    match = [f for f in findings if f.kind == kind and f.stream == stream]
    assert match, [finding.line() for finding in findings]
    return match[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_clean_drive_is_left_alone(seed: int) -> None:
    assert check_drive(clean_drive(seed)) == []


@pytest.mark.parametrize("name", list(MISTAKES))
def test_a_mistake_is_noticed_and_its_stream_named(clean: Drive, name: str) -> None:
    change, kind, stream, severity = MISTAKES[name]
    if name == "wrong zone":
        # what the fixes' longitudes give in another zone's plane
        from polemap.drivelog.frames import transform_points

        points = np.stack([clean.gnss.east_m, clean.gnss.north_m], axis=1)
        there = transform_points(points, clean.frame, EarthFrame("utm", 32634))
        clean = with_gnss(clean, east_m=there[:, 0], north_m=there[:, 1])
    finding = found(change(clean), kind, stream)
    assert finding.severity == severity
    assert finding.value
    assert finding.expected
    assert finding.remedy
    assert len(finding.line()) < 300


@pytest.mark.parametrize("parts", ["odometry", "reference", "gnss", "scans"])
def test_streams_that_are_missing_are_no_mistake(clean: Drive, parts: str) -> None:
    nothing: tuple | None = () if parts == "scans" else None
    assert check_drive(replace(clean, **{parts: nothing})) == []


def test_a_lone_odometry_is_held_against_what_cars_do(clean: Drive) -> None:
    alone = replace(clean, gnss=None, reference=None, scans=())
    assert check_drive(alone) == []
    assert {f.kind for f in check_drive(_rate(57.2958)(alone))} == {"yaw_rate_range"}
    assert {f.kind for f in check_drive(_speed(100.0)(alone))} >= {"speed_range"}
    assert {f.kind for f in check_drive(_speed(-1.0)(alone))} == {"speed_sign"}


def test_poles_judge_an_odometry_that_nothing_else_does(clean: Drive) -> None:
    alone = replace(clean, gnss=None, reference=None)
    assert check_drive(alone) == []
    turned = found(_rate(-1.0)(alone), "pole_turn", "odometry.csv")
    assert "y of poles.csv" in turned.remedy
    assert found(_speed(3.6)(alone), "pole_speed", "odometry.csv").severity == "error"


def test_fixes_judge_an_odometry_without_a_reference(clean: Drive) -> None:
    rough = replace(clean, reference=None, scans=())
    assert check_drive(rough) == []
    assert found(_speed(3.6)(rough), "speed_unit", "odometry.csv").severity == "error"
    assert found(_rate(-1.0)(rough), "yaw_rate_sign", "odometry.csv").severity == "error"
    assert found(_rate(57.2958)(rough), "yaw_rate_unit", "odometry.csv").severity == "error"


def test_a_gap_of_a_day_costs_nothing_and_is_said(clean: Drive) -> None:
    later = clean.odometry.stamp_s + np.where(clean.odometry.stamp_s > 40.0, 86_400.0, 0.0)
    gapped = replace(
        with_odometry(clean, stamp_s=later, arrival_s=later), gnss=None, reference=None, scans=()
    )
    assert [f.kind for f in check_drive(gapped)] == ["gap"]


def test_outliers_of_the_fixes_are_no_mistake(clean: Drive) -> None:
    east = clean.gnss.east_m.copy()
    east[::9] += 150.0
    assert check_drive(with_gnss(clean, east_m=east)) == []


def test_a_standing_car_says_nothing() -> None:
    drive = clean_drive(0)
    t = drive.odometry.stamp_s
    still = with_odometry(drive, speed_mps=0 * t, yaw_rate_radps=0 * t)
    poses = np.tile(drive.reference.poses[0], (len(t), 1))
    still = replace(still, reference=ReferenceStream(t, poses, np.full(len(t), 0.02)), scans=())
    rng = np.random.default_rng(1)
    east = poses[0, 0] + rng.standard_normal(len(still.gnss))
    north = poses[0, 1] + rng.standard_normal(len(still.gnss))
    assert check_drive(with_gnss(still, east_m=east, north_m=north)) == []
