"""Wheels, camera, both: what a drive's motion comes from, and how each corrects the other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.camera_motion import CameraTrack, PlanarMotion
from polemap.drivelog.detections import pole_detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.odometry_choice import resolve, with_odometry
from polemap.drivelog.odometry_fusion import fuse_odometry
from polemap.drivelog.readers.derived import ODOMETRY_NOTE
from polemap.drivelog.samples import Image
from polemap.drivelog.streams import OdometryStream
from polemap.stereo.rig import StereoRig

RATE_S = 0.02


class _Pictures:
    def load(self, row: int) -> tuple[Image, Image]:
        raise AssertionError("not read")

    def keep(self, rows: NDArray[np.int64]) -> _Pictures:
        return self


def _speed(t: NDArray[np.float64]) -> NDArray[np.float64]:
    return 8.0 + 2.0 * np.sin(0.3 * t)


def _camera(seconds: float = 60.0) -> CameraTrack:
    rng = np.random.default_rng(7)
    stamps = np.arange(0.0, seconds, 0.1)
    middle = 0.5 * (stamps[1:] + stamps[:-1])
    n = len(middle)
    planar = PlanarMotion(
        middle,
        stamps[1:] + 0.05,
        _speed(middle) + 0.02 * rng.standard_normal(n),
        0.1 * np.cos(0.2 * middle) + 0.001 * rng.standard_normal(n),
        np.zeros(n),
        np.full(n, 0.02),
        np.full(n, 0.001),
    )
    return CameraTrack(stamps, np.tile(np.eye(4), (len(stamps), 1, 1)), planar, {}, 0.0)


def _wheels(seconds: float = 60.0) -> OdometryStream:
    stamps = np.arange(0.0, seconds, RATE_S)
    yaw_rate = 0.1 * np.cos(0.2 * stamps)
    return OdometryStream(stamps, stamps, 1.03 * _speed(stamps), yaw_rate + 0.004)


def test_scale_and_offset_of_the_wheels_are_found() -> None:
    fused = fuse_odometry(_wheels(), _camera())
    # a share of the ratio, small by its prior, is the camera's
    assert fused.wheel_scale == pytest.approx(1.03, abs=0.003)
    assert fused.yaw_offset_radps == pytest.approx(0.004, abs=3e-4)
    late = fused.stream.stamp_s > 30.0
    true = _speed(fused.stream.stamp_s[late])
    assert fused.stream.speed_mps[late] == pytest.approx(true, rel=0.004)
    assert fused.replaced == fused.filled == 0


@pytest.mark.parametrize(("factor", "seconds"), [(0.0, 1.0), (1.3, 3.0), (1.8, 1.0), (0.5, 2.0)])
def test_wheels_that_slip_are_found_by_the_camera(factor: float, seconds: float) -> None:
    wheels = _wheels()
    slips = (wheels.stamp_s > 30.0) & (wheels.stamp_s < 30.0 + seconds)
    speed = np.where(slips, factor * wheels.speed_mps, wheels.speed_mps)
    fused = fuse_odometry(replace(wheels, speed_mps=speed), _camera())
    assert fused.replaced == pytest.approx(10 * seconds, abs=2)
    inside = (fused.stream.stamp_s > 30.1) & (fused.stream.stamp_s < 29.9 + seconds)
    true = _speed(fused.stream.stamp_s[inside])
    assert fused.stream.speed_mps[inside] == pytest.approx(true, abs=0.35)
    assert fused.wheel_scale == pytest.approx(1.03, abs=0.004)
    # what the camera corrected was known when its picture was
    assert (fused.stream.arrival_s[inside] > fused.stream.stamp_s[inside]).all()


@pytest.mark.parametrize("seen_mps", [0.0, 14.0])
def test_a_camera_that_follows_a_bus_is_found_by_the_wheels(seen_mps: float) -> None:
    camera = _camera()
    stamps = camera.planar.stamp_s
    beside = (stamps > 30.0) & (stamps < 33.0)
    speed = np.where(beside, seen_mps, camera.planar.speed_mps)
    # at first it knew nothing
    known = ~((stamps > 30.0) & (stamps < 30.25))
    planar = replace(camera.planar, speed_mps=speed).take(known)
    fused = fuse_odometry(_wheels(), replace(camera, planar=planar))
    assert fused.replaced == 0
    assert fused.refused == pytest.approx(27, abs=2)
    inside = (fused.stream.stamp_s > 30.0) & (fused.stream.stamp_s < 33.0)
    true = _speed(fused.stream.stamp_s[inside])
    assert fused.stream.speed_mps[inside] == pytest.approx(true, rel=0.006)


def test_wheels_that_freeze_are_found_by_the_camera() -> None:
    """They do not jump, the camera does not either: it is the wheels that are too smooth."""
    wheels = _wheels()
    frozen = (wheels.stamp_s > 30.0) & (wheels.stamp_s < 36.0)
    speed = np.where(
        frozen, wheels.speed_mps[~frozen & (wheels.stamp_s < 30.0)][-1], wheels.speed_mps
    )
    fused = fuse_odometry(replace(wheels, speed_mps=speed), _camera())
    assert fused.replaced > 30
    assert fused.refused == 0
    late = (fused.stream.stamp_s > 33.0) & (fused.stream.stamp_s < 36.0)
    assert fused.stream.speed_mps[late] == pytest.approx(
        _speed(fused.stream.stamp_s[late]), abs=0.35
    )


def test_holes_of_the_wheels_are_filled_and_of_the_camera_bridged() -> None:
    wheels = _wheels()
    wheels = wheels.take((wheels.stamp_s < 20.0) | (wheels.stamp_s > 24.0))
    camera = _camera()
    kept = (camera.planar.stamp_s < 40.0) | (camera.planar.stamp_s > 50.0)
    fused = fuse_odometry(wheels, replace(camera, planar=camera.planar.take(kept)))
    assert fused.filled == pytest.approx(40, abs=2)
    stamps = fused.stream.stamp_s
    assert np.diff(stamps).max() < 0.11
    assert (np.diff(stamps) > 0).all()
    blind = (stamps > 41.0) & (stamps < 49.0)
    assert fused.stream.speed_mps[blind] == pytest.approx(_speed(stamps[blind]), rel=0.006)


def _drive(tmp_path: Path, *, wheels: bool, derived: bool = False, pictures: bool = True) -> Drive:
    return Drive(
        "d",
        tmp_path,
        EarthFrame("local", name="x"),
        2.7,
        rig=StereoRig(400, 240, 380.0, 200.0, 120.0, 0.3) if pictures else None,
        frame_stamps_s=np.arange(0.0, 60.0, 0.1) if pictures else np.empty(0),
        frame_arrivals_s=np.arange(0.0, 60.0, 0.1) if pictures else np.empty(0),
        frame_numbers=np.arange(600) if pictures else np.empty(0, dtype=np.int64),
        images=_Pictures() if pictures else None,
        odometry=_wheels() if wheels else None,
        odometry_is_derived=derived,
        notes=(ODOMETRY_NOTE,) if derived else (),
    )


def test_auto_takes_measured_wheels_then_the_camera(tmp_path: Path) -> None:
    assert resolve(_drive(tmp_path, wheels=True), "auto") == "wheels"
    assert resolve(_drive(tmp_path, wheels=True, derived=True), "auto") == "camera"
    assert resolve(_drive(tmp_path, wheels=False), "auto") == "camera"
    only = _drive(tmp_path, wheels=True, derived=True, pictures=False)
    assert resolve(only, "auto") == "derived"
    assert resolve(_drive(tmp_path, wheels=False, pictures=False), "auto") == "wheels"


@pytest.mark.parametrize(
    ("choice", "wheels", "derived", "pictures", "lacks"),
    [
        ("wheels", True, True, True, "a measured odometry"),
        ("camera", True, False, False, "stereo pictures"),
        ("both", True, False, False, "stereo pictures"),
        ("both", False, False, True, "a measured odometry"),
        ("derived", True, False, True, "derived from its reference"),
    ],
)
def test_what_a_drive_lacks_is_refused(
    tmp_path: Path, choice: str, wheels: bool, derived: bool, pictures: bool, lacks: str
) -> None:
    drive = _drive(tmp_path, wheels=wheels, derived=derived, pictures=pictures)
    with pytest.raises(InputError, match=lacks):
        resolve(drive, choice)
    with pytest.raises(ConfigError, match="choose auto, wheels, camera, both, derived"):
        resolve(drive, "wheel")


def test_the_drive_says_where_its_motion_comes_from(tmp_path: Path) -> None:
    derived = _drive(tmp_path, wheels=True, derived=True)
    camera = with_odometry(derived, "auto", lambda _: _camera())
    assert camera.odometry is not None
    assert len(camera.odometry) == 599
    assert not camera.odometry_is_derived
    assert ODOMETRY_NOTE not in camera.notes
    assert any("stereo camera's (599 of 599 steps)" in note for note in camera.notes)
    both = with_odometry(_drive(tmp_path, wheels=True), "both", lambda _: _camera())
    assert any("wheel speed x 0.97" in note for note in both.notes)
    assert with_odometry(derived, "derived") is derived


def test_a_camera_that_tells_nothing_is_refused(tmp_path: Path) -> None:
    blind = _camera()
    blind = replace(blind, planar=blind.planar.take(slice(0, 0)), unknown={"too few corners": 599})
    with pytest.raises(InputError, match="599 x too few corners"):
        with_odometry(_drive(tmp_path, wheels=False), "camera", lambda _: blind)


@pytest.mark.parametrize("choice", ["camera", "both"])
def test_the_cameras_course_goes_with_its_odometry_but_not_with_other_detectors_poles(
    tmp_path: Path, choice: str
) -> None:
    track = _camera()
    aside = np.full(len(track.planar), 0.1)
    track = replace(track, planar=track.planar.with_columns(lateral_mps=aside))
    drive = _drive(tmp_path, wheels=True)
    seen = with_odometry(drive, choice, lambda _: track).odometry
    assert seen is not None
    told = np.flatnonzero(np.isfinite(seen.lateral_mps))
    assert len(told) == pytest.approx(len(aside), abs=2)
    assert set(seen.lateral_mps[told]) == {0.1}
    # no sample knows it before its picture is there
    later = np.searchsorted(track.planar.arrival_s, seen.arrival_s[told], side="right")
    assert np.all(later >= np.arange(1, len(told) + 1))
    other = replace(
        drive, scans=(pole_detections(0.0, 0.0, np.zeros((1, 2)), np.zeros((1, 2, 2))),)
    )
    elsewhere = with_odometry(other, choice, lambda _: track).odometry
    assert elsewhere is not None
    assert np.isnan(elsewhere.lateral_mps).all()
