"""Ground, hypotheses, features, refinement and visibility on a street whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.detect.config import DetectionConfig
from polemap.detect.constants import AXIS_SHARE
from polemap.detect.detection import FrameView, detect
from polemap.detect.features import NAMES
from polemap.detect.ground import fit_ground, ground_from_mounting
from polemap.detect.refine import refine_disparity
from polemap.drivelog.samples import StereoFrame
from polemap.stereo.depth_edges import upright_maps
from polemap.stereo.matching import DisparityPair
from polemap.stereo.rig import Mounting, StereoRig
from tests.polemap.street import RIG, Thing, street

CONFIG = DetectionConfig()


def see(things: list[Thing], noise_px: float = 0.1, seed: int = 1) -> FrameView:
    left, right, maps = street(things, np.random.default_rng(seed), noise_px)
    return detect(StereoFrame(0.0, 0.0, 0, left, right), maps, RIG, None, CONFIG)


def nearest(view: FrameView, thing: Thing) -> int:
    gap = np.hypot(*(view.detections.points_vehicle_m - (thing.x_m, thing.y_m)).T)
    assert len(gap), "nothing was found"
    assert gap.min() < 0.6
    return int(gap.argmin())


def test_ground_of_the_mounting_is_the_plane_of_the_road() -> None:
    ground = ground_from_mounting(RIG)
    points = np.array([[10.0, 2.0, 0.0], [20.0, -3.0, 0.0], [7.0, 0.0, 0.0]])
    u, v, d = RIG.project(points).T
    assert np.allclose(ground.row_px(u, d), v, atol=1e-9)


@pytest.mark.parametrize(
    ("pitch", "roll"), [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.02), (0.01, -0.015)]
)
def test_ground_follows_pitch_and_roll(pitch: float, roll: float) -> None:
    true = StereoRig(640, 400, 700.0, 319.5, 190.0, 0.4, Mounting(1.5, 0.1, 1.4, roll, pitch, 0.0))
    truth = ground_from_mounting(true)
    v, u = np.mgrid[0:400, 0:640]
    d = truth.offset + truth.per_column * u + truth.per_row * v
    noisy = d + 0.15 * np.random.default_rng(3).standard_normal(d.shape)
    disparity = np.where(d > 3, noisy, np.nan).astype(np.float32)
    ground = fit_ground(upright_maps(DisparityPair(disparity, disparity), 2), RIG)
    assert ground.fitted
    where_u, where_d = np.array([200.0, 320.0, 440.0]), np.array([28.0, 19.0, 14.0])
    assert np.abs(ground.row_px(where_u, where_d) - truth.row_px(where_u, where_d)).max() < 3.0


def test_ground_falls_back_to_the_mounting_without_disparity() -> None:
    empty = np.full((400, 640), np.nan, dtype=np.float32)
    ground = fit_ground(upright_maps(DisparityPair(empty, empty), 2), RIG)
    assert ground == ground_from_mounting(RIG)
    assert not ground.fitted


@pytest.mark.parametrize("x_m", [8.0, 12.0, 18.0])
@pytest.mark.parametrize("width_m", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("lean", [0.0, 0.1])
def test_pole_is_found_where_it_stands(x_m: float, width_m: float, lean: float) -> None:
    pole = Thing(x_m, 1.0, width_m, 3.5, lean=lean)
    view = see([pole])
    found, row = view.detections, nearest(view, pole)
    # a board has no axis behind its surface; the eye assumes a cylinder
    behind = AXIS_SHARE * found.width_m[row]
    error = found.points_vehicle_m[row] - (pole.x_m + behind, pole.y_m)
    forward = pole.x_m - RIG.vehicle_from_camera.x_m
    assert abs(error[0]) < 0.2 * forward**2 / (RIG.focal_px * RIG.baseline_m) + 0.03
    assert abs(error[1]) < 1.2 * forward / RIG.focal_px + 0.03 + 0.5 * abs(lean) * 0.2
    assert abs(found.width_m[row] - width_m) < 3.0 * forward / RIG.focal_px
    assert abs(np.sum(error**2)) < 9.0 * np.trace(found.covariance_m2[row])


def test_partly_hidden_pole_and_bollard_are_found() -> None:
    lamp = Thing(14.0, -1.5, 0.15, 4.0)
    car = Thing(10.0, -1.2, 1.8, 1.2)  # hides the lower part of the lamp
    bollard = Thing(9.0, 2.0, 0.12, 0.9)
    view = see([car, lamp, bollard])
    for thing in (lamp, bollard):
        nearest(view, thing)


def test_wall_kerb_and_floating_things_make_no_hypothesis() -> None:
    wall = Thing(12.0, 0.0, 8.0, 5.0)
    kerb = Thing(9.0, 3.0, 0.3, 0.2)
    floating = Thing(10.0, 2.5, 0.2, 5.0, base_m=2.9)
    assert len(see([kerb]).detections) == 0
    assert len(see([floating]).detections) == 0
    found = see([wall]).detections
    assert not np.any(np.abs(found.points_vehicle_m[:, 1]) < 3.0)


def test_empty_disparity_gives_no_hypotheses_and_an_open_view() -> None:
    empty = np.full((400, 640), np.nan, dtype=np.float32)
    image = np.zeros((400, 640), dtype=np.uint8)
    view = detect(
        StereoFrame(0.0, 0.0, 0, image, image), DisparityPair(empty, empty), RIG, None, CONFIG
    )
    assert len(view.detections) == 0
    assert view.detections.features.shape == (0, len(NAMES))
    assert view.region.contains(np.array([15.0, 0.0]))


def test_features_are_finite_and_named() -> None:
    view = see([Thing(10.0, 1.0, 0.2, 3.0), Thing(15.0, -2.0, 0.3, 4.0)])
    assert view.detections.features.shape[1] == len(NAMES)
    assert np.isfinite(view.detections.features).all()


def test_hidden_ground_is_not_in_view_and_a_pole_does_not_hide_itself() -> None:
    wall = Thing(12.0, -3.0, 4.0, 4.0)
    pole = Thing(14.0, 3.0, 0.5, 4.0)
    region = see([wall, pole]).region
    assert not region.contains(np.array([20.0, -4.5]))
    assert region.contains(np.array([14.0, 3.0]))
    assert region.contains(np.array([20.0, 0.0]))
    assert not region.contains(np.array([-5.0, 0.0]))
    assert not region.contains(np.array([CONFIG.range_max_m + 3.0, 0.0]))


@pytest.mark.parametrize("offset", [-0.8, -0.3, 0.4, 0.9])
def test_refinement_finds_the_disparity_of_a_candidate(offset: float) -> None:
    pole = Thing(11.3, 0.7, 0.3, 3.5)
    left, right, _ = street([pole], np.random.default_rng(5))
    forward = pole.x_m - RIG.vehicle_from_camera.x_m
    true = RIG.focal_px * RIG.baseline_m / forward
    u = RIG.cx_px - (pole.y_m - RIG.vehicle_from_camera.y_m) / forward * RIG.focal_px
    half = 0.5 * pole.width_m / forward * RIG.focal_px
    one = [
        np.array([value]) for value in (u - half + 2, u + half - 2, 60.0, 250.0, 0.0, true + offset)
    ]
    fit = refine_disparity(left, right, *one)
    assert fit.trusted[0]
    assert abs(fit.disparity_px[0] - true) < 0.1


def test_refinement_keeps_its_start_where_the_images_disagree() -> None:
    rng = np.random.default_rng(6)
    left, right = (rng.integers(0, 255, (100, 200)).astype(np.uint8) for _ in range(2))
    one = [np.array([value]) for value in (100.0, 108.0, 10.0, 90.0, 0.0, 20.0)]
    fit = refine_disparity(left, right, *one)
    assert not fit.trusted[0]
    assert fit.disparity_px[0] == 20.0
    assert np.isnan(fit.sd_px[0])
