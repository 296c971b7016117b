"""Corners in disparities that are drawn from walls whose ends are known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from polemap.detect.config import DetectionConfig
from polemap.detect.corner_features import NAMES
from polemap.detect.corners import StereoCorners
from polemap.detect.detection import FrameView, detect
from polemap.detect.models.io import read_classifier, read_corner_classifier
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.samples import StereoFrame
from polemap.stereo.matching import DisparityPair
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import wrap_angle
from tests.polemap.street import RIG

CONFIG = DetectionConfig(kinds=("pole", "corner"))
FAR_PX = 4.0  # what stands behind all walls


@dataclass(frozen=True)
class Wall:
    """An upright plane from `start` to `end` on the ground, vehicle frame."""

    start: tuple[float, float]
    end: tuple[float, float]
    height_m: float = 4.0


def _ray(rig: StereoRig) -> tuple[np.ndarray, np.ndarray]:
    """Origin `(3,)` and directions `(h, w, 3)` of the view's pixels, one metre ahead each."""
    v, u = np.mgrid[0 : rig.height_px, 0 : rig.width_px].astype(float)
    camera = np.stack(
        [(u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px, np.ones_like(u)], axis=-1
    )
    mount = rig.vehicle_from_camera
    return np.array([mount.x_m, mount.y_m, mount.z_m]), camera @ mount.rotation().T


@cache  # seeds of one scene share it
def disparity_of(walls: tuple[Wall, ...], rig: StereoRig, shift_m: float) -> np.ndarray:
    """Disparity `(h, w)` of road and walls, seen `shift_m` to the right of the left camera."""
    origin, ray = _ray(rig)
    origin = origin + np.array([0.0, -shift_m, 0.0])
    depth = np.full(ray.shape[:2], rig.focal_px * rig.baseline_m / FAR_PX)
    with np.errstate(divide="ignore", invalid="ignore"):
        road = -origin[2] / ray[..., 2]
        depth = np.where((ray[..., 2] < 0) & (road < depth), road, depth)
        for wall in walls:
            start, along = np.array(wall.start), np.subtract(wall.end, wall.start)
            normal = np.array([-along[1], along[0]])
            away = ((start - origin[:2]) @ normal) / (ray[..., :2] @ normal)
            hit = origin + away[..., None] * ray
            share = ((hit[..., :2] - start) @ along) / (along @ along)
            good = (away > 0) & (away < depth) & (share >= 0) & (share <= 1)
            good &= (hit[..., 2] >= 0) & (hit[..., 2] <= wall.height_m)
            depth = np.where(good, away, depth)
    return np.asarray(rig.focal_px * rig.baseline_m / depth)


def matched_maps(walls: list[Wall], seed: int = 1, noise_px: float = 0.15) -> DisparityPair:
    """Noisy maps, the half-occluded bands of both views unmatched."""
    return _matched(walls, np.random.default_rng(seed), noise_px)[0]


def _matched(
    walls: list[Wall], rng: np.random.Generator, noise_px: float
) -> tuple[DisparityPair, np.ndarray]:
    """The same, and the true left map."""
    left, right = (disparity_of(tuple(walls), RIG, shift) for shift in (0.0, RIG.baseline_m))
    v, u = np.mgrid[0 : RIG.height_px, 0 : RIG.width_px]

    def checked(one: np.ndarray, other: np.ndarray, sign: float) -> np.ndarray:
        at = np.rint(u + sign * one).astype(int)
        inside = (at >= 0) & (at < RIG.width_px)
        back = other[v, np.clip(at, 0, RIG.width_px - 1)]
        noisy = one + noise_px * rng.standard_normal(one.shape)
        return np.where(inside & (np.abs(back - one) <= 1.0), noisy, np.nan).astype(np.float32)

    return DisparityPair(checked(left, right, -1.0), checked(right, left, 1.0)), left


def see(walls: list[Wall], seed: int = 1, noise_px: float = 0.15) -> FrameView:
    """The frame with its maps, and grey pictures."""
    rng = np.random.default_rng(seed)
    maps, left = _matched(walls, rng, noise_px)
    grey = np.clip(60.0 + 3.0 * left + 4.0 * rng.standard_normal(left.shape), 0, 255)
    picture = grey.astype(np.uint8)
    return detect(StereoFrame(0.0, 0.0, 0, picture, picture), maps, RIG, None, CONFIG)


def corners_of(view: FrameView) -> StereoCorners:
    assert view.corners is not None
    return view.corners


def gap_m(corners: StereoCorners, place: tuple[float, float]) -> np.ndarray:
    return np.hypot(*(corners.points_vehicle_m - place).T)


WALL_ENDS = [
    (Wall((12.0, -3.0), (12.0, -6.0)), (12.0, -3.0)),  # across the road, free towards it
    (Wall((12.0, 3.0), (12.0, 6.5)), (12.0, 3.0)),
    (Wall((12.0, -3.0), (15.0, -5.5)), (12.0, -3.0)),  # slanted
    (Wall((15.0, 2.5), (17.5, 5.0), 1.6), (15.0, 2.5)),  # low
    (Wall((6.0, -4.0), (14.0, -4.0)), (14.0, -4.0)),  # along the road, its far end
]


@pytest.mark.parametrize(("wall", "end"), WALL_ENDS)
def test_a_walls_end_is_a_corner_that_faces_away_from_the_wall(
    wall: Wall, end: tuple[float, float]
) -> None:
    corners = corners_of(see([wall]))
    row = int(gap_m(corners, end).argmin())
    error = corners.points_vehicle_m[row] - end
    nees = float(error @ np.linalg.solve(corners.covariance_m2[row], error))
    assert nees < 9.2  # of 2 degrees of freedom, 99 %
    away = np.subtract(end, wall.start if end == wall.end else wall.end)
    true_rad = np.arctan2(away[1], away[0])
    assert abs(wrap_angle(corners.facing_rad[row] - true_rad)) < np.radians(15)
    assert (corners.kind == LandmarkKind.CORNER).all()
    assert corners.height_m[row] == pytest.approx(
        min(wall.height_m, corners.height_m[row]), abs=0.3
    )


def test_the_free_side_of_a_box_corner_is_away_from_the_face_that_is_seen() -> None:
    box = [Wall((12.0, -3.0), (12.0, -7.0)), Wall((12.0, -3.0), (17.0, -3.0))]
    corners = corners_of(see(box))
    # the face along the road is seen too: it ends at its far corner, and the near one has no step
    far = gap_m(corners, (17.0, -3.0))
    assert far.min() < 0.6
    facing = corners.facing_rad[int(far.argmin())]
    assert abs(wrap_angle(facing - 0.0)) < np.radians(25)


def test_a_post_and_a_plain_road_have_no_corner() -> None:
    post = [Wall((10.0, -2.85), (10.0, -3.15), 3.0)]
    assert (gap_m(corners_of(see(post)), (10.0, -3.0)) > 1.0).all()
    assert len(corners_of(see([]))) == 0


def test_a_wall_that_goes_on_has_no_corner_in_its_middle() -> None:
    through = Wall((9.0, -2.0), (22.0, -7.0))
    corners = corners_of(see([through]))
    inside = (corners.points_vehicle_m[:, 0] > 10.5) & (corners.points_vehicle_m[:, 0] < 20.5)
    assert not inside.any()


def test_poles_are_found_alike_with_corners_beside_them() -> None:
    walls = [Wall((12.0, 3.0), (12.0, 6.5)), Wall((10.0, -2.9), (10.0, -3.1), 3.0)]
    view = see(walls)
    both = view.landmarks
    assert len(both) == len(view.detections) + len(corners_of(view))
    moved = both.with_columns(points_vehicle_m=both.points_vehicle_m + 1.0)
    back = view.located(moved)
    np.testing.assert_array_equal(back.landmarks.points_vehicle_m, moved.points_vehicle_m)
    np.testing.assert_array_equal(back.detections.left_px, view.detections.left_px)


def test_places_err_as_their_covariance_says() -> None:
    end, nees = (12.0, -3.0), []
    for seed in range(12):
        corners = corners_of(see([Wall(end, (12.5, -6.0))], seed, noise_px=0.3))
        row = int(gap_m(corners, end).argmin())
        error = corners.points_vehicle_m[row] - end
        nees.append(float(error @ np.linalg.solve(corners.covariance_m2[row], error)) / 2.0)
    # the stated covariance holds what white noise of a synthetic scene lacks, so it is cautious
    assert np.mean(nees) < 1.5


def test_the_model_of_corners_fits_their_features_and_no_other() -> None:
    model = read_corner_classifier("corners")
    assert model.names == NAMES
    assert str(model.origin["command"]).startswith("polemap train")
    with pytest.raises(Exception, match="trained on other features"):
        read_classifier("corners")
    with pytest.raises(Exception, match="trained on other features"):
        read_corner_classifier("default")


def test_the_model_prefers_a_wall_to_a_cars_flank() -> None:
    model = read_corner_classifier("corners")
    wall = corners_of(see([Wall((12.0, -3.0), (12.4, -7.0))]))
    car = corners_of(
        see([Wall((12.0, -1.2), (12.0, -3.0), 1.3), Wall((12.0, -1.2), (16.0, -1.2), 1.3)])
    )
    likely = model.probability(wall.features[[int(gap_m(wall, (12.0, -3.0)).argmin())]])
    assert likely[0] > 0.5
    assert (model.probability(car.features) < likely[0]).all()
