"""Tracks against a simulated truth: consistency, ids, birth and death."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.track import tracking
from polemap.track.config import TrackingConfig
from polemap.track.constants import ERROR_TIME_S, GATE_PROBABILITY, POLE_SHARE, SPEED_SD_MPS
from polemap.track.tracking import PoleTracker
from polemap.track.tracks import Motion
from polemap.vehicle.pose import (
    Pose2D,
    compose,
    inverse_transform_points,
    rotation,
    wrap_angle,
)

CONFIG = TrackingConfig()
Floats = NDArray[np.float64]


def view_to(range_m: float) -> VisibleRegion:
    return VisibleRegion(np.zeros(2), -0.8, 0.8, 2.0, np.full(16, range_m))


def detected(
    stamp_s: float,
    points: Floats,
    sd_m: float = 0.1,
    probability: float = 0.95,
    view: VisibleRegion | None = None,
    width_m: float = 0.2,
) -> Detections:
    points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    n = len(points)
    return pole_detections(
        stamp_s,
        stamp_s,
        points,
        np.tile(sd_m**2 * np.eye(2), (n, 1, 1)),
        width_m=np.full(n, width_m),
        probability=np.full(n, probability),
        view=view,
    )


@dataclass(frozen=True)
class Passage:
    """NEES of every confirmed track in every frame, and how many ids a pole got."""

    nees: Floats
    ids_per_pole: Floats


def drive_by(rate_hz: float, seed: int, error_time_s: float) -> Passage:
    """A straight road with poles on both sides; correlated errors, noisy odometry, misses."""
    rng = np.random.default_rng(seed)
    poles = np.column_stack([np.arange(10.0, 120.0, 9.0), np.where(np.arange(13) % 2, 4.0, -4.0)])
    dt, speed = 1.0 / rate_hz, 10.0
    tracker = PoleTracker(CONFIG)
    keep = np.exp(-dt / error_time_s)
    error = rng.standard_normal((len(poles), 2))
    nees, owner = [], {}
    pose = np.zeros(3)
    for step in range(int(9.0 * rate_hz)):
        local = inverse_transform_points(pose, poles)
        away = np.hypot(*local.T)
        seen = (away < 22.0) & (away > 3.0) & (np.abs(np.arctan2(local[:, 1], local[:, 0])) < 0.7)
        shown = seen & (rng.random(len(poles)) < 0.85)
        error = keep * error + np.sqrt(1 - keep**2) * rng.standard_normal(error.shape)
        sd = np.stack([0.04 + 0.0015 * away**2, 0.05 + 0.004 * away], axis=1)
        ray = local / away[:, None]
        across = np.stack([-ray[:, 1], ray[:, 0]], axis=1)
        points = local + error[:, :1] * sd[:, :1] * ray + error[:, 1:] * sd[:, 1:] * across
        covariance = (
            sd[:, :1, None] ** 2 * ray[:, :, None] * ray[:, None, :]
            + sd[:, 1:, None] ** 2 * across[:, :, None] * across[:, None, :]
        )
        n = np.count_nonzero(shown)
        ids = tracker.correct_tracks(
            pole_detections(
                step * dt,
                step * dt,
                points[shown],
                covariance[shown],
                width_m=np.full(n, 0.2),
                probability=np.full(n, 0.9),
                view=view_to(23.0),
            )
        )
        for pole, track in zip(np.flatnonzero(shown), ids, strict=True):
            owner.setdefault(int(pole), set()).add(int(track))
        tracks = tracker.tracks
        for track in np.flatnonzero(tracks.confirmed & (tracks.detection >= 0)):
            gap = local - tracks.points_vehicle_m[track]
            off = gap[np.hypot(*gap.T).argmin()]
            nees.append(off @ np.linalg.solve(tracks.covariance_m2[track], off))
        turn = 0.03 * np.sin(0.5 * step * dt) * dt
        forward = speed * dt
        pose = compose(pose, [forward, 0.0, turn])
        noisy_m = forward * (1 + CONFIG.speed_sd_share * rng.standard_normal())
        noisy_m += SPEED_SD_MPS * dt * rng.standard_normal()
        noisy_turn = turn + CONFIG.yaw_rate_sd_radps * dt * rng.standard_normal()
        tracker.predict_tracks(Motion(dt, noisy_m, 0.0, noisy_turn, forward))
    counts = [len(ids - {-1}) for ids in owner.values()]
    return Passage(np.array(nees), np.array(counts, dtype=np.float64))


@pytest.mark.parametrize("rate_hz", [10.0, 13.0, 22.0])
def test_tracks_are_consistent_and_keep_their_ids(rate_hz: float) -> None:
    passages = [drive_by(rate_hz, seed, ERROR_TIME_S) for seed in range(6)]
    nees = np.concatenate([p.nees for p in passages])
    # tracks of one pole are alike from frame to frame: about one fresh value a pole and second
    independent = 6 * 13 * 1.5
    low, high = chi2.ppf([0.0005, 0.9995], 2 * independent) / independent
    assert low * 0.8 < nees.mean() < high * 1.1
    assert np.concatenate([p.ids_per_pole for p in passages]).mean() < 1.15


def test_id_survives_a_short_occlusion_and_an_unseen_pole_dies() -> None:
    tracker = PoleTracker(CONFIG)
    blocked = VisibleRegion(np.zeros(2), -0.8, 0.8, 2.0, np.full(16, 8.0))
    for step in range(5):
        ids = tracker.correct_tracks(detected(0.1 * step, [12.0, 1.0], view=view_to(25.0)))
    first = ids[0]
    for step in range(5, 15):  # a second behind a van
        tracker.predict_tracks(Motion(0.1, 0.0, 0.0, 0.0, 0.0))
        tracker.correct_tracks(detected(0.1 * step, np.empty((0, 2)), view=blocked))
    assert tracker.tracks.confirmed.tolist() == [True]
    assert tracker.correct_tracks(detected(1.5, [12.05, 1.0], view=view_to(25.0)))[0] == first
    for step in range(16, 30):  # in plain view, and not there
        tracker.correct_tracks(detected(0.1 * step, np.empty((0, 2)), view=view_to(25.0)))
    assert len(tracker.tracks) == 0


def test_one_doubtful_detection_is_not_confirmed_and_two_good_ones_are() -> None:
    tracker = PoleTracker(CONFIG)
    tracker.correct_tracks(detected(0.0, [10.0, 0.0], probability=0.6))
    assert not tracker.tracks.confirmed.any()
    tracker = PoleTracker(CONFIG)
    tracker.correct_tracks(detected(0.0, [10.0, 0.0], probability=0.97))
    assert not tracker.tracks.confirmed.any()
    tracker.correct_tracks(detected(0.1, [10.0, 0.0], probability=0.97))
    assert tracker.tracks.confirmed.all()
    faint = PoleTracker(CONFIG)
    faint.correct_tracks(detected(0.0, [10.0, 0.0], probability=0.25))
    assert len(faint.tracks) == 0


def test_twice_the_frames_are_not_twice_the_evidence() -> None:
    odds = []
    for rate_hz in (10, 40):
        tracker = PoleTracker(CONFIG)
        tracker.correct_tracks(detected(0.0, [10.0, 0.0], probability=0.7))
        for step in range(1, rate_hz // 5 + 1):
            tracker.correct_tracks(detected(step / rate_hz, [10.0, 0.0], probability=0.7))
        odds.append(tracker.tracks.log_odds[0])
    assert odds[0] == pytest.approx(odds[1], abs=1e-9)


def test_assignment_is_optimal_where_the_nearest_is_wrong() -> None:
    tracker = PoleTracker(CONFIG)
    ids = tracker.correct_tracks(detected(0.0, [[10.0, 0.0], [10.0, 0.5]], sd_m=0.3))
    # both moved left by 0.35: the first detection is nearest to the second track
    later = tracker.correct_tracks(detected(0.1, [[10.0, 0.35], [10.0, 0.85]], sd_m=0.3))
    assert later.tolist() == ids.tolist()


def test_gate_bears_a_new_track_beyond_it() -> None:
    tracker = PoleTracker(CONFIG)
    one = tracker.correct_tracks(detected(0.0, [10.0, 0.0]))
    assert tracker.correct_tracks(detected(0.1, [10.0, 1.5]))[0] != one[0]
    assert len(tracker.tracks) == 2


def test_prediction_moves_points_and_spreads_them() -> None:
    tracker = PoleTracker(CONFIG)
    tracker.correct_tracks(detected(0.0, [[10.0, 2.0], [15.0, -3.0]]))
    before = tracker.tracks
    move = Pose2D(1.2, 0.1, 0.2)
    tracker.predict_tracks(Motion(0.1, move.x_m, move.y_m, move.yaw_rad, 1.25))
    after = tracker.tracks
    expected = inverse_transform_points(move, before.points_vehicle_m)
    assert np.allclose(after.points_vehicle_m, expected)
    for one, two in zip(before.covariance_m2, after.covariance_m2, strict=True):
        assert np.linalg.eigvalsh(two)[0] > 0
        assert np.trace(two) > np.trace(one)


def test_width_and_height_are_averaged_and_unknown_ones_skipped() -> None:
    tracker = PoleTracker(CONFIG)
    for step, width in enumerate((0.2, np.nan, 0.3, 0.25)):
        tracker.correct_tracks(detected(0.1 * step, [10.0, 0.0], width_m=width))
    assert 0.2 < tracker.tracks.width_m[0] < 0.3
    assert np.isnan(tracker.tracks.height_m[0])


@pytest.mark.parametrize("seed", range(4))
def test_a_track_takes_a_detection_by_its_mahalanobis_distance(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracking, "GATE_MAX_M", 50.0)
    rng = np.random.default_rng(seed)
    root = rng.normal(0, 0.15, (2, 2))
    spread = root @ root.T + 1e-3 * np.eye(2)
    gate = np.sqrt(chi2.ppf(GATE_PROBABILITY, 2))
    direction = rng.normal(0, 1, 2)
    # the first and the second detection have the same covariance: their sum is twice that
    edge = gate * direction / np.sqrt(direction @ np.linalg.solve(2.0 * spread, direction))
    for part, taken in ((0.99, True), (1.01, False)):
        tracker = PoleTracker(CONFIG)
        for stamp, point in (
            (0.0, np.array([8.0, 1.0])),
            (0.1, np.array([8.0, 1.0]) + part * edge),
        ):
            one = replace(detected(stamp, point[None]), covariance_m2=spread[None])
            ids = tracker.correct_tracks(one)
        assert (ids[0] == 0) == taken


def test_tracks_are_moved_by_the_error_that_they_share_once_it_is_known() -> None:
    rng = np.random.default_rng(5)
    wrong, right = PoleTracker(CONFIG), PoleTracker(CONFIG)
    poles, error = np.array([[20.0, 3.0], [14.0, -4.0]]), 0.3
    for step in range(8):
        if step:
            for tracker in (wrong, right):
                tracker.predict_tracks(Motion(0.1, 1.0, 0.0, 0.01, 1.0))
            turn = np.array([[np.cos(0.01), -np.sin(0.01)], [np.sin(0.01), np.cos(0.01)]])
            poles = (poles - [1.0, 0.0]) @ turn
        per_unit = -poles * poles[:, :1] / 247.0
        seen = poles + 0.02 * rng.standard_normal(poles.shape)
        right.correct_tracks(replace(detected(0.1 * step, seen), shift_per_px_m=per_unit))
        wrong.correct_tracks(
            replace(detected(0.1 * step, seen + error * per_unit), shift_per_px_m=per_unit)
        )
    gap = wrong.tracks.points_vehicle_m - right.tracks.points_vehicle_m
    assert np.hypot(*gap.T).min() > 0.1
    # a track still leans on what it saw from afar
    now = np.hypot(*(error * per_unit).T)
    assert (np.hypot(*gap.T) > now).all()
    wrong.shift_tracks(-error)
    np.testing.assert_allclose(
        wrong.tracks.points_vehicle_m, right.tracks.points_vehicle_m, atol=1e-3
    )
    wide = wrong.tracks.with_shared(error**2).covariance_m2 - wrong.tracks.covariance_m2
    np.testing.assert_allclose(wide, gap[:, :, None] * gap[:, None, :], atol=1e-3)


def test_what_the_detector_takes_for_granted_is_no_evidence() -> None:
    for probability, sign in ((POLE_SHARE, 0.0), (0.6, 1.0), (0.3, -1.0)):
        tracker = PoleTracker(CONFIG)
        for step in range(4):
            tracker.correct_tracks(
                detected(0.1 * step, np.array([10.0, 2.0]), probability=probability)
            )
        assert np.sign(np.round(tracker.tracks.log_odds, 9)).tolist() == [sign]


def test_a_track_takes_detections_of_its_own_kind_only() -> None:
    tracker = PoleTracker(CONFIG)
    pole = detected(0.0, [10.0, 2.0])
    sign = detected(0.1, [10.0, 2.0]).with_columns(kind=np.ones(1, dtype=np.int8))
    first = tracker.correct_tracks(pole)
    assert tracker.correct_tracks(sign)[0] != first[0]
    assert tracker.correct_tracks(detected(0.2, [10.0, 2.0]))[0] == first[0]


def test_the_free_side_of_a_corner_turns_with_the_car_and_is_averaged_over_the_full_circle() -> (
    None
):
    tracker = PoleTracker(TrackingConfig())
    corner = np.array([[10.0, 3.0]])
    for step, facing in enumerate([np.pi - 0.1, -np.pi + 0.1]):
        # the second look is turned to the left by 0.2, so its vehicle frame sees everything turned
        if step:
            tracker.predict_tracks(Motion(0.1, 0.0, 0.0, 0.2, 0.0))
            corner = corner @ rotation(-0.2).T
        seen = detected(0.1 * step, corner)
        tracker.correct_tracks(
            replace(
                seen,
                kind=np.array([LandmarkKind.CORNER], dtype=np.int8),
                facing_rad=np.array([facing]),
            )
        )
    assert tracker.tracks.kind.tolist() == [LandmarkKind.CORNER]
    # predicted pi - 0.3, seen -pi + 0.1: half way between them across the cut of the circle
    assert wrap_angle(tracker.tracks.facing_rad[0] - (np.pi - 0.1)) == pytest.approx(0.0, abs=1e-9)
