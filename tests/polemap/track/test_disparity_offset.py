"""The learned disparity offset, on sightings of standing poles from a moving car."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.detections import pole_detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.line_detections import line_detections
from polemap.stereo.rig import Mounting, StereoRig
from polemap.track.config import TrackingConfig
from polemap.track.disparity_offset import DisparityOffset
from polemap.track.tracks import Motion, Tracks

RIG = StereoRig(768, 480, 823.5, 383.5, 239.5, 0.30, Mounting(1.9, 0.15, 1.3, 0.0, 0.0, 0.0))
FOCAL_BASELINE = RIG.focal_px * RIG.baseline_m
ORIGIN = np.array([1.9, 0.15])
STEP_M, DT_S = 0.8, 0.1


def drive(
    missing_px: float,
    config: TrackingConfig,
    *,
    seed: int = 0,
    frames: int = 60,
    scale: float = 0.0,
    turning_radps: float = 0.0,
) -> DisparityOffset:
    """A car on a gentle bend past six poles; every disparity lacks `missing_px`.

    Its odometry is `scale` too long and turns `turning_radps` too fast.
    """
    rng = np.random.default_rng(seed)
    offset = DisparityOffset(RIG, config)
    poles = np.array([[20 + 9.0 * k, (-1) ** k * 4.0 + 0.05 * k**2] for k in range(6)])
    pose = np.zeros(3)
    for frame in range(frames):
        if frame:
            turn = 0.004
            said_m = STEP_M * (1.0 + scale)
            offset.dead_reckon(Motion(DT_S, said_m, 0.0, turn + turning_radps * DT_S, said_m))
            pose = pose + np.array([STEP_M * np.cos(pose[2]), STEP_M * np.sin(pose[2]), turn])
        c, s = np.cos(pose[2]), np.sin(pose[2])
        rays = (poles - pose[:2]) @ np.array([[c, -s], [s, c]]) - ORIGIN
        seen = np.flatnonzero((rays[:, 0] > 4.0) & (rays[:, 0] < 25.0))
        rays, count = rays[seen], len(seen)
        raw = FOCAL_BASELINE / rays[:, 0] - missing_px + 0.1 * rng.standard_normal(count)
        points = offset.corrected(ORIGIN + rays * (FOCAL_BASELINE / raw / rays[:, 0])[:, None])
        away = rays[:, 0]
        covariance = np.zeros((count, 2, 2))
        covariance[:, 0, 0] = (0.3 * away**2 / FOCAL_BASELINE) ** 2 + 1e-3
        covariance[:, 1, 1] = 0.05**2
        none = np.zeros(count)
        detections = pole_detections(frame * DT_S, frame * DT_S, points, covariance)
        tracks = Tracks(
            seen.astype(np.int64), detections.kind, points, covariance, none, none, none, none,
            np.ones(count, np.int64), none, none, np.ones(count, bool), np.arange(count),
            np.zeros((count, 2)), np.full(count, np.nan),
        )  # fmt: skip
        offset.learn_from_tracks(detections, tracks, DT_S if frame else np.inf)
    return offset


@pytest.mark.parametrize("missing_px", [-0.3, 0.0, 0.3])
def test_a_constant_error_of_all_disparities_is_learned(missing_px: float) -> None:
    learned = [drive(missing_px, TrackingConfig(), seed=seed) for seed in range(5)]
    assert learned[0].sd_px < 0.6 * TrackingConfig().disparity_offset_sd_px
    for one in learned:
        assert one.value_px == pytest.approx(missing_px, abs=3.0 * one.sd_px)
    # what is left is at most the pull of the prior
    kept = 1.0 - (learned[0].sd_px / TrackingConfig().disparity_offset_sd_px) ** 2
    mean = np.mean([one.value_px for one in learned])
    assert mean == pytest.approx(kept * missing_px, abs=0.05)


def test_without_prior_spread_nothing_is_learned() -> None:
    off = drive(0.3, TrackingConfig(disparity_offset_sd_px=0.0))
    assert off.value_px == 0.0
    assert off.sd_px == 0.0


def test_a_standing_car_learns_nothing() -> None:
    offset = drive(0.3, TrackingConfig(), frames=1)
    assert offset.value_px == 0.0
    assert offset.sd_px == TrackingConfig().disparity_offset_sd_px


def test_a_track_that_contradicts_the_others_is_left_out() -> None:
    assert drive(3.0, TrackingConfig()).value_px == 0.0


@pytest.mark.parametrize(("scale", "turning_radps"), [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.01)])
def test_a_fault_of_the_odometry_is_not_taken_for_an_offset(
    scale: float, turning_radps: float
) -> None:
    config = TrackingConfig()
    one = drive(0.2, config, scale=scale, turning_radps=turning_radps)
    assert one.sd_px < 0.6 * config.disparity_offset_sd_px
    assert one.value_px == pytest.approx(0.2, abs=2.0 * one.sd_px)


def test_points_move_by_what_a_pixel_more_does() -> None:
    offset = DisparityOffset(RIG, TrackingConfig())
    point = np.array([[18.0, 5.0]])
    offset.value_px = 1e-4
    moved = (offset.corrected(point) - point) / 1e-4
    np.testing.assert_allclose(offset.shift_per_px(point), moved, rtol=1e-4)


def test_lines_move_as_their_points_and_know_less() -> None:
    offset = DisparityOffset(RIG, TrackingConfig(disparity_offset_sd_px=0.3))
    start, end = np.array([[8.0, 3.0]]), np.array([[14.0, 3.2]])
    lines = line_detections(LandmarkKind.KERB, start, end, np.array([0.03]), np.array([0.004]))
    offset.value_px = 0.2
    moved = offset.corrected_lines(lines)
    np.testing.assert_allclose(moved.start_vehicle_m, offset.corrected(start))
    np.testing.assert_allclose(moved.end_vehicle_m, offset.corrected(end))
    # what is left of the offset, by finite differences
    offset.value_px = 0.2 + 1e-4
    more = offset.corrected_lines(lines)
    normal = np.array([-np.sin(moved.direction_rad[0]), np.cos(moved.direction_rad[0])])
    shift = float((more.middle_vehicle_m - moved.middle_vehicle_m)[0] @ normal) / 1e-4 * 0.3
    turn = float((more.direction_rad - moved.direction_rad)[0]) / 1e-4 * 0.3
    np.testing.assert_allclose(moved.offset_sd_m, np.hypot(0.03, shift), rtol=0.02)
    np.testing.assert_allclose(moved.direction_sd_rad, np.hypot(0.004, turn), rtol=0.02)
