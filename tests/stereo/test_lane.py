"""The road plane there and back, drawn lanes with known truth, and real highway pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.stereo.lane import LaneFinder, LaneSettings
from polemap.stereo.lane_fit import Learned
from polemap.stereo.lane_ransac import agree_on_parabola, needed_trials
from polemap.stereo.rig import Mounting, StereoRig
from polemap.stereo.road_plane import BirdsEye, MountedCamera, RoadCamera, RoadGrid
from polemap.vehicle.errors import VehicleError

CAMERA = RoadCamera.from_focal(640, 480, 600.0, 1.3, 0.08)


@given(x=st.floats(3.0, 80.0), y=st.floats(-10.0, 10.0))
def test_mapping_there_and_back(x: float, y: float) -> None:
    pixel = CAMERA.road_to_pixel([x, y])
    assert CAMERA.pixel_to_road(pixel) == pytest.approx([x, y], abs=1e-6)


def test_mapping_is_the_pinholes() -> None:
    """Against a rotation and a division, no tangents."""
    c, s, f = np.cos(0.08), np.sin(0.08), 600.0
    x, y, h = 12.0, 1.5, 1.3
    depth, down, left = x * c + h * s, -x * s + h * c, y
    row, column = 239.5 + f * down / depth, 319.5 - f * left / depth
    assert CAMERA.road_to_pixel([x, y]) == pytest.approx([row, column], abs=1e-9)


def test_above_the_horizon_there_is_no_road() -> None:
    assert np.isnan(CAMERA.pixel_to_road([0.0, 320.0])[0])


def drawn(
    offset_m: float, slope: float, bend: float, seed: int = 0, right_m: float | None = None
) -> np.ndarray:
    """A noisy road: a solid left line `y = offset + slope x + bend x^2`, 0.15 m wide.

    With `right_m` also a dashed right one that far to the right of it.
    """
    rows, columns = np.indices((480, 640))
    road = CAMERA.pixel_to_road(np.stack([rows, columns], axis=-1))
    x, y = road[..., 0], road[..., 1]
    off = y - offset_m - slope * x - bend * x * x
    line = np.abs(off) < 0.075
    if right_m is not None:
        line |= (np.abs(off + right_m) < 0.075) & (np.mod(x, 9.0) < 4.0)
    image = np.where(line & (x < 60.0), 190.0, 90.0)
    image += 4.0 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def finder(**changes: object) -> LaneFinder:
    settings = LaneSettings(**{"confirm_frames": 1, **changes})  # type: ignore[arg-type]
    return LaneFinder(CAMERA, rng=np.random.default_rng(0), preview_m=8.0, settings=settings)


@pytest.mark.parametrize("response", ["across", "isotropic"])
@pytest.mark.parametrize(
    ("offset", "slope", "bend"),
    [(1.7, 0.0, 0.0), (1.4, 0.03, 0.0), (1.8, -0.02, 0.002), (1.9, 0.02, -0.004)],
)
def test_drawn_lane_is_measured_within_its_deviation(
    offset: float, slope: float, bend: float, response: str
) -> None:
    seen = finder(response=response).find(drawn(offset, slope, bend, right_m=3.4), 2.0, 2.03)
    assert seen is not None
    assert set(seen.points_m) == {"left", "right"}
    tangent = slope + 2.0 * bend * 8.0
    middle = offset - 1.7 + 8 * slope + 64 * bend
    root = np.hypot(1.0, tangent)
    true = np.array([-np.arctan(tangent), -middle / root, 2.0 * bend / root**3])
    error = np.array([seen.heading_rad, seen.lateral_offset_m, seen.curvature_per_m]) - true
    assert error @ np.linalg.solve(seen.covariance, error) < 16.3  # 99.9 % of three
    assert np.abs(error[:2]) == pytest.approx(0.0, abs=0.03)
    assert abs(error[2]) < 0.002
    assert (seen.stamp_s, seen.arrival_s) == (2.0, 2.03)
    assert seen.width_m == pytest.approx(3.4, abs=0.1)


def test_one_marking_leaves_the_offset_as_wide_as_lanes_differ() -> None:
    one = finder().find(drawn(1.7, 0.0, 0.0), 0.0, 0.0)
    both = finder().find(drawn(1.7, 0.0, 0.0, right_m=3.4), 0.0, 0.0)
    assert one is not None
    assert both is not None
    assert set(one.points_m) == {"left"}
    assert one.covariance[1, 1] > 25.0 * both.covariance[1, 1]
    assert abs(one.lateral_offset_m) < 3.0 * np.sqrt(one.covariance[1, 1])


def test_a_width_that_was_seen_is_kept_when_one_marking_ends() -> None:
    lanes = finder()
    for k in range(4):
        both = lanes.find(drawn(1.6, 0.0, 0.0, k, right_m=3.0), 0.1 * k, 0.1 * k)
    one = lanes.find(drawn(1.6, 0.0, 0.0, 9), 0.4, 0.4)
    assert both is not None
    assert one is not None
    assert set(one.points_m) == {"left"}
    assert one.lateral_offset_m == pytest.approx(both.lateral_offset_m, abs=0.05)
    assert one.covariance[1, 1] < 0.1**2


def test_an_error_of_the_pitch_is_learned_from_markings_that_diverge() -> None:
    """The camera nods by 0.6 degrees; the slopes of both sides are wrong, their mean is not."""
    true = RoadCamera.from_focal(640, 480, 600.0, 1.3, 0.09)
    rows, columns = np.indices((480, 640))
    road = true.pixel_to_road(np.stack([rows, columns], axis=-1))
    lines = (np.abs(road[..., 1] - 1.2) < 0.075) | (np.abs(road[..., 1] + 2.3) < 0.075)
    image = np.where(lines, 190, 90).astype(np.uint8)
    seen = finder().find(image, 0.0, 0.0)
    assert seen is not None
    assert abs(seen.heading_rad) < 0.006
    # 0.01 rad over 1.3 m, and the further away the more
    assert seen.fit.state[4] == pytest.approx(0.01 / 1.3, rel=0.4)


def test_a_jumping_lane_is_gated_and_then_searched_afresh() -> None:
    lanes = finder()
    assert lanes.find(drawn(1.6, 0.0, 0.0), 0.0, 0.0) is not None
    answers = [lanes.find(drawn(2.6, 0.0, 0.0, k), 0.1 * k, 0.1 * k) for k in range(1, 8)]
    assert answers[0] is None
    assert answers[-1] is not None
    assert answers[-1].lateral_offset_m == pytest.approx(-2.6 + 1.75, abs=0.1)


def test_a_lane_is_told_from_the_third_picture_on_that_agrees() -> None:
    lanes = LaneFinder(CAMERA, rng=np.random.default_rng(0), preview_m=8.0)
    answers = [lanes.find(drawn(1.6, 0.0, 0.0, k), 0.1 * k, 0.1 * k) for k in range(4)]
    assert [seen is not None for seen in answers] == [False, False, True, True]


def test_what_the_car_drives_bounds_the_lane() -> None:
    image = drawn(1.7, 0.0, 0.0, right_m=3.4)
    assert finder().find(image, 0.0, 0.0, 0.001) is not None
    assert finder().find(image, 0.0, 0.0, -0.05) is None  # narrower than can be looked at


def test_an_empty_road_gives_nothing() -> None:
    noise = np.random.default_rng(1).integers(80, 100, (480, 640)).astype(np.uint8)
    assert LaneFinder(CAMERA, rng=np.random.default_rng(0)).find(noise, 0.0, 0.0) is None
    black = np.zeros((480, 640), np.uint8)
    assert LaneFinder(CAMERA, rng=np.random.default_rng(0)).find(black, 0.0, 0.0) is None


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_samples_are_as_many_as_the_share_of_inliers_asks(share: float) -> None:
    """One in a thousand searches sees no clean sample: by the formula and by drawing."""
    needed = needed_trials(share)
    assert (1.0 - share**3) ** needed <= 1e-3
    assert (1.0 - share**3) ** (needed - 2) > 1e-3 or needed <= 2
    rng = np.random.default_rng(2)
    x = rng.uniform(5.0, 25.0, 400)
    on = rng.random(400) < share
    points = np.column_stack([x, np.where(on, 1.5 + 0.002 * x * x, rng.uniform(0.2, 3.6, 400))])
    agreed = agree_on_parabola(
        points,
        np.ones(400),
        tolerance_m=0.1,
        slope=(-0.3, 0.3),
        curvature_per_m=(-0.03, 0.03),
        rng=rng,
    )
    assert agreed is not None
    assert agreed.inliers[on].mean() > 0.95
    assert agreed.trials <= max(64, needed + 64)


def test_nothing_that_could_be_a_marking_is_told() -> None:
    across = np.column_stack([np.full(50, 9.0), np.linspace(0.0, 3.0, 50)])
    assert needed_trials(0.0) == float("inf")
    assert needed_trials(1.0) == 1.0
    assert (
        agree_on_parabola(
            across, np.ones(50), tolerance_m=0.1, slope=(-0.3, 0.3), curvature_per_m=(-0.03, 0.03),
            rng=np.random.default_rng(0),
        )
        is None
    )  # fmt: skip


def test_a_mounted_camera_is_the_road_camera_where_both_can_be_had() -> None:
    rig = StereoRig(640, 480, 600.0, 319.5, 239.5, 0.3, Mounting(1.5, 0.2, 1.3, pitch_rad=0.08))
    points = np.random.default_rng(0).uniform((4.0, -3.0), (40.0, 3.0), (50, 2))
    mounted = MountedCamera(rig)
    assert mounted.road_to_pixel(points + np.array([1.5, 0.2])) == pytest.approx(
        CAMERA.road_to_pixel(points), abs=1e-9
    )
    assert (mounted.ahead_m, CAMERA.ahead_m) == (1.5, 0.0)
    assert not BirdsEye(mounted, RoadGrid(near_m=-5.0)).seen[-1].any()  # behind the camera


def test_what_is_learned_narrows_to_the_scatter() -> None:
    rng = np.random.default_rng(3)
    learned = Learned(3.5, 0.35**2, 0.03**2, 0.0)
    for _ in range(200):
        value, noise = 3.2 + 0.03 * rng.standard_normal(), 0.02**2
        prior = learned.spread
        gain = prior / (prior + noise)
        measured = value + 0.02 * rng.standard_normal()
        learned.learn(learned.mean + gain * (measured - learned.mean), (1.0 - gain) * prior)
    assert learned.mean == pytest.approx(3.2, abs=0.01)
    # a mean of 200 pictures, each with the scatter and the noise
    assert learned.variance == pytest.approx((0.03**2 + 0.02**2) / 200, rel=0.05)


def test_wrong_images_and_cameras_are_refused() -> None:
    with pytest.raises(VehicleError, match="a grey one"):
        BirdsEye(CAMERA, RoadGrid()).warp(np.zeros((10, 10), np.uint8))
    with pytest.raises(VehicleError, match="road camera"):
        RoadCamera(640, 480, 0.5, 0.4, -1.0, 0.1)
    with pytest.raises(VehicleError, match="angles"):
        RoadCamera(640, 480, 2.0, 0.4, 1.0, 0.1)


def test_highway_pictures_show_both_markings(recording: Callable[[str], Path]) -> None:
    for path in sorted(recording("lanes").glob("*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        height, width = image.shape
        focal = width * 0.9
        pitch = -float(np.arctan((0.09 * height) / focal))
        camera = RoadCamera.from_focal(width, height, focal, 1.3, pitch)
        seen = LaneFinder(
            camera,
            rng=np.random.default_rng(0),
            preview_m=10.0,
            settings=LaneSettings(confirm_frames=1),
        ).find(image, 0.0, 0.0)
        assert seen is not None, path.name
        assert abs(seen.heading_rad) < 0.04, path.name
        assert abs(seen.lateral_offset_m) < 0.6, path.name
        assert 3.4 < seen.width_m < 4.3, path.name  # 3.7 m lanes; focal length and height guessed
        assert set(seen.points_m) == {"left", "right"}, path.name
