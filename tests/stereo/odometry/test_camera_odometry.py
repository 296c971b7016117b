"""The camera's motion through rendered pictures with known motion, and through bad ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.camera_motion import track_camera
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.registry import open_drive
from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.scenario import Scenario
from polemap.stereo.errors import StereoError
from polemap.stereo.odometry.camera_odometry import CameraOdometry
from polemap.stereo.odometry.corners import (
    bits_of,
    find_corners,
    follow,
    grey_shares,
    same_exposure,
    thinned,
)


@pytest.fixture(scope="module")
def bend(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """Some three seconds: standing, then a straight and a bend to the left."""
    scenario = Scenario.model_validate(
        {
            "name": "bend",
            "route": {
                "closed": False,
                "corner_radius_m": 9.0,
                "corners_m": [[0, 0], [14, 0], [22, 12]],
            },
            "rows": [
                {"kind": "lamp", "side": "right", "spacing_m": 9, "offset_m": 0.5},
                {"kind": "thin_post", "side": "left", "spacing_m": 7, "offset_m": 1.0},
            ],
            "drive": {"speed_mps": 7.0, "standstill_s": 0.5},
        }
    )
    camera = CameraConfig(width_px=480, height_px=300, focal_px=420.0, frame_rate_hz=10.0)
    config = SimulateConfig(camera=camera, render=RenderConfig(workers=1, shadows=False))
    place = tmp_path_factory.mktemp("bend")
    simulate_drive(scenario, place / "drive", 1, 3, config)
    return open_drive(place / "drive")


def _turned(drive: Drive, stamps: NDArray[np.float64]) -> NDArray[np.float64]:
    assert drive.reference is not None
    return np.interp(stamps, drive.reference.stamp_s, np.unwrap(drive.reference.poses[:, 2]))


def test_the_way_and_the_turn_of_a_rendered_drive(bend: Drive) -> None:
    track = track_camera(bend, lambda _: None)
    assert bend.reference is not None
    assert not track.unknown
    rows = track.planar
    steps = np.diff(track.stamp_s)
    reference = np.stack(
        [np.interp(track.stamp_s, bend.reference.stamp_s, p) for p in bend.reference.poses.T[:2]]
    )
    way = np.linalg.norm(np.diff(reference, axis=1), axis=0).sum()
    # the stated deviation of a step bounds that of the sum, plus half a percent of scale
    sd = float(np.sqrt(np.sum((rows.speed_sd_mps * steps) ** 2)))
    assert (rows.speed_mps * steps).sum() == pytest.approx(way, abs=3 * sd + 0.015 * way)
    turn = np.diff(_turned(bend, track.stamp_s[[0, -1]]))[0]
    assert turn > 0.5
    sd_turn = float(np.sqrt(np.sum((rows.yaw_rate_sd_radps * steps) ** 2)))
    assert (rows.yaw_rate_radps * steps).sum() == pytest.approx(turn, abs=3 * sd_turn + 0.005)


def test_standing_is_measured_as_standing(bend: Drive) -> None:
    track = track_camera(bend.between(0.0, 0.45), lambda _: None)
    assert len(track.planar) >= 3
    assert np.abs(track.planar.speed_mps).max() < 0.1
    assert np.abs(track.planar.yaw_rate_radps).max() < 0.005


def _pairs(drive: Drive) -> list[tuple[float, NDArray[np.uint8], NDArray[np.uint8]]]:
    frames = [drive.read_frame(row) for row in range(len(drive.frame_stamps_s))]
    return [
        (f.stamp_s, np.asarray(f.left, np.uint8), np.asarray(f.right, np.uint8)) for f in frames
    ]


def test_what_shows_nothing_is_no_motion(bend: Drive) -> None:
    assert bend.rig is not None
    odometry = CameraOdometry(bend.rig)
    known, kinds = [], []
    for row, (stamp, left, right) in enumerate(_pairs(bend)[8:20]):
        dark = row in (4, 5)
        views = (np.full_like(left, 3), np.full_like(right, 3)) if dark else (left, right)
        motion = odometry.advance(stamp, *views)
        known.append(motion.known)
        kinds.append(motion.kind)
        assert np.isfinite(motion.covariance).all() == motion.known
    assert known == [False, *[True] * 3, *[False] * 3, *[True] * 5]
    assert kinds[0] == "first pair"
    assert kinds[4] == "too few corners"


def test_an_exposure_that_jumps_changes_little(bend: Drive) -> None:
    assert bend.rig is not None
    pairs = _pairs(bend)[8:18]
    moved = []
    for jump in (False, True):
        odometry = CameraOdometry(bend.rig)
        steps = []
        for row, (stamp, left, right) in enumerate(pairs):
            brighter = jump and row >= 5
            views = [
                cv2.convertScaleAbs(v, alpha=0.55, beta=10) if brighter else v
                for v in (left, right)
            ]
            steps.append(odometry.advance(stamp, *views).current_from_previous[2, 3])
        moved.append(steps)
    assert moved[1] == pytest.approx(moved[0], abs=0.02)


def test_sixteen_bit_pictures_move_as_eight_bit_ones(bend: Drive) -> None:
    assert bend.rig is not None
    eight, twelve = CameraOdometry(bend.rig), CameraOdometry(bend.rig)
    for stamp, left, right in _pairs(bend)[8:14]:
        a = eight.advance(stamp, left, right)
        b = twelve.advance(stamp, *(v.astype(np.uint16) * 16 for v in (left, right)))
        assert b.current_from_previous == pytest.approx(a.current_from_previous, abs=0.02)


def test_wrong_pictures_and_stamps_are_refused(bend: Drive) -> None:
    assert bend.rig is not None
    odometry = CameraOdometry(bend.rig)
    stamp, left, right = _pairs(bend)[0]
    with pytest.raises(
        StereoError, match=r"right picture at .* is 480x299, the camera's are 480x300"
    ):
        odometry.advance(stamp, left, right[1:])
    odometry.advance(stamp, left, right)
    with pytest.raises(StereoError, match="does not follow"):
        odometry.advance(stamp, left, right)


def test_a_drive_without_pictures_is_refused(tmp_path: Path, bend: Drive) -> None:
    with pytest.raises(InputError, match="needs stereo pictures"):
        track_camera(bend.between(1e6, 2e6), lambda _: None)


def test_corners_spread_and_leave_taken_cells(bend: Drive) -> None:
    left = _pairs(bend)[10][1]
    corners = find_corners(left, np.empty((0, 2)))
    assert len(corners) > 30
    cells = {tuple(c) for c in (corners // (40, 30)).astype(int).tolist()}
    assert len(cells) == len(corners)
    assert not len(find_corners(left, corners))
    assert not len(find_corners(np.full((100, 200), 90, np.uint8), np.empty((0, 2))))


def test_of_a_crowd_the_surest_corner_stays() -> None:
    places = np.array([[5.0, 5.0], [6.0, 7.0], [100.0, 5.0], [5.0, 100.0]])
    assert thinned(places, np.array([2.0, 1.0, 3.0, 3.0])).tolist() == [1, 2, 3]
    assert thinned(places[:0], np.empty(0)).tolist() == []


def test_following_finds_a_shift() -> None:
    rng = np.random.default_rng(0)
    big = cv2.GaussianBlur(rng.integers(0, 255, (220, 320)).astype(np.uint8), (0, 0), 2.0)
    a, b = big[10:210, 10:310].copy(), big[12:212, 7:307].copy()
    points = np.array([[100.0, 80.0], [200.0, 120.0]])
    found, good = follow(a, b, points, points, 2)
    assert good.all()
    assert found - points == pytest.approx(np.array([[3.0, -2.0]] * 2), abs=0.05)
    assert len(follow(a, b, points[:0], points[:0], 2)[0]) == 0


def test_exposure_is_brought_to_the_other_picture_and_bits_are_seen() -> None:
    rng = np.random.default_rng(1)
    picture = rng.integers(60, 180, (80, 80)).astype(np.uint8)
    darker = cv2.convertScaleAbs(picture, alpha=0.5, beta=5)
    shares, dark_shares = grey_shares(picture), grey_shares(darker)
    brought = same_exposure(darker, dark_shares, shares)
    assert brought.mean() == pytest.approx(picture.mean(), abs=2)
    assert np.abs(brought.astype(int) - picture).max() <= 4
    assert same_exposure(picture, shares, shares) is picture
    assert bits_of(picture) == 8
    assert bits_of(picture.astype(np.uint16) * 16) == 12
