"""A detector's calibration held against the way the car goes, on made drives past made poles."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, pole_detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.samples import OdometrySample
from polemap.localize.config import PolesConfig
from polemap.localize.particle_filter.detector_check import KINDS, DetectorCheck
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.vehicle.pose import inverse_transform_points, rotation

Floats = NDArray[np.float64]

SD_M = 0.05


def mapped(points_m: Floats) -> Landmarks:
    n = len(points_m)
    return Landmarks(
        kind=np.full(n, LandmarkKind.POLE, dtype=np.int8),
        points_m=points_m,
        covariance_m2=np.tile([0.0025, 0.0025, 0.0], (n, 1)),
        width_m=np.full(n, np.nan),
        detection=np.full(n, 0.7),
        ids=np.arange(n),
    )


def scan_at(stamp_s: float, points_m: Floats) -> Detections:
    covariance = np.tile(SD_M**2 * np.eye(2), (len(points_m), 1, 1))
    return pole_detections(stamp_s, stamp_s, points_m, covariance)


def street(rng: np.random.Generator) -> Floats:
    """Poles every 8 m on both sides of a road that bends."""
    along = np.arange(0.0, 300.0, 8.0)
    left = np.stack([along, 6.0 + rng.normal(0.0, 0.5, len(along))], axis=1)
    right = np.stack([along + 4.0, -5.0 + rng.normal(0.0, 0.5, len(along))], axis=1)
    return np.vstack([left, right])


class Widest(DetectorCheck):
    """Remembers the largest hint of a drive."""

    widest_m = 0.0

    def _judge(self, pose: Floats, travelled_m: float) -> bool:
        found = super()._judge(pose, travelled_m)
        self.widest_m = max(self.widest_m, self.hinted_sd[0])
        return found


def drive(
    seed: int,
    check: DetectorCheck | None = None,
    *,
    turn_rad: float = 0.0,
    scale: float = 1.0,
    early_s: float = 0.0,
    from_m: float = 0.0,
    until_m: float = np.inf,
    suspected_m: float = np.inf,
    rate_offset_radps: float = 0.0,
    swerve_lost: float = 0.0,
) -> tuple[DetectorCheck, list[str]]:
    """A drive of 220 m at 7 to 10 m/s, its errors on a part of the way; what was found at each
    scan, "open" where nothing was, but the calibration is not acquitted either.

    Args:
        swerve_lost: share of the turn that the odometry loses while the car swerves to the left
            from 10 s to 12 s; it comes back in two more seconds, and sees no pole in all four.
    """
    rng = np.random.default_rng(seed)
    poles = street(rng)
    landmarks = mapped(poles + rng.normal(0.0, 0.05, poles.shape))
    check = check or DetectorCheck(PolesConfig())
    found = []

    def rates(seconds: float) -> tuple[float, float]:
        swerve = 0.3 * ((10.0 <= seconds < 12.0) - 1.0 * (12.0 <= seconds < 14.0))
        turn = 0.05 * np.cos(0.5 * seconds) + (swerve if swerve_lost else 0.0)
        return 8.5 + 1.5 * np.sin(seconds), turn

    truth = np.zeros(3)
    dead = np.zeros(3)
    travelled, dt = 0.0, 0.1
    for k in range(260):
        speed, turn = rates(dt * k)
        lost = swerve_lost * turn if 10.0 <= dt * k < 12.0 else 0.0
        for pose, rate in ((truth, turn), (dead, turn + rate_offset_radps - lost)):
            middle = pose[2] + 0.5 * rate * dt
            pose += dt * np.array([speed * np.cos(middle), speed * np.sin(middle), rate])
        travelled += speed * dt
        wrong = from_m <= travelled < until_m
        looked = truth.copy()
        if wrong and early_s:
            then, rate = rates(dt * (k + 1) + 0.5 * early_s)
            looked += early_s * np.array([then * np.cos(truth[2]), then * np.sin(truth[2]), rate])
        seen = inverse_transform_points(looked, poles)
        seen = seen[(seen[:, 0] > 3.0) & (seen[:, 0] < 25.0)]
        seen = seen + rng.normal(0.0, SD_M, seen.shape)
        if wrong:
            seen = scale * seen @ rotation(turn_rad).T
        if swerve_lost and 10.0 <= dt * k < 14.0:
            seen = seen[:0]
        if travelled >= suspected_m:
            check.suspect()
            suspected_m = np.inf
        scan = scan_at(dt * k, seen)
        # the pose that a filter would have: the poles' heading, and the place not quite
        pose = looked + np.array([0.1, -0.1, -turn_rad * wrong])
        check.add_scan(scan, landmarks, pose, dead, travelled, (speed, turn))
        found.append(check.contradicts or ("" if check.acquitted else "open"))
    return check, found


@pytest.mark.parametrize("seed", range(3))
def test_a_sound_detector_is_never_accused_though_the_gyroscope_is_off(seed: int) -> None:
    check, found = drive(seed, rate_offset_radps=0.004)
    # of a start the ranges are asked for some metres
    assert set(found[15:]) == {""}
    assert check.hinted_sd[0] < 0.2
    assert check.fit is not None
    assert np.all(np.abs(check.fit.values) < 4.0 * np.hypot(check.fit.sd, [0.003, 0.003, 0.01]))


@pytest.mark.parametrize(
    ("kind", "error", "column", "value"),
    [
        ("turned", {"turn_rad": 0.05}, 0, 0.05),
        ("turned", {"turn_rad": -0.05}, 0, -0.05),
        ("ranges", {"scale": 0.9}, 1, -0.1),
        ("ranges", {"scale": 1.1}, 1, 0.1),
        ("stamps", {"early_s": 0.4}, 2, 0.4),
    ],
)
def test_what_is_wrong_is_found_and_how_much(
    kind: str, error: dict[str, float], column: int, value: float
) -> None:
    check, found = drive(7, **error)
    assert found[-1] == kind
    assert check.fit is not None
    assert check.fit.values[column] == pytest.approx(
        value, abs=4.0 * check.fit.sd[column] + 0.05 * abs(value)
    )


def way_m(found: list[str], kind: str) -> float:
    """About how far the car was when a kind was found first."""
    return 0.85 * found.index(kind)


@pytest.mark.parametrize(
    ("kind", "error"),
    [("turned", {"turn_rad": 0.035}), ("turned", {"turn_rad": -0.035}), ("ranges", {"scale": 1.1})],
)
@pytest.mark.parametrize("seed", range(2))
def test_a_change_on_the_way_is_told_within_15_m(
    kind: str, error: dict[str, float], seed: int
) -> None:
    _, found = drive(seed, from_m=100.0, rate_offset_radps=0.002, **error)
    assert set(found[15:110]) == {""}
    assert 95.0 < way_m(found, kind) < 115.0
    assert found[-1] == kind


def test_after_a_contradiction_the_looks_from_there_on_must_acquit_the_detector() -> None:
    _, sound = drive(4, suspected_m=80.0)
    opened = way_m(sound[20:], "open") + 20 * 0.85
    assert 75.0 < opened < 85.0
    assert 15 < sound[20:].count("open") < 90
    assert sound[-1] == ""


@pytest.mark.parametrize("error", [{"turn_rad": 0.035}, {"early_s": 0.3}, {"scale": 0.93}])
def test_a_wrong_detector_is_never_acquitted(error: dict[str, float]) -> None:
    _, found = drive(5, from_m=79.0, suspected_m=80.0, **error)
    assert "" not in found[110:]


def test_a_likely_error_widens_the_pose() -> None:
    check, found = drive(6, turn_rad=0.016)
    assert "turned" not in found[:40]
    largest_m, largest_rad = check.hinted_sd
    assert 0.05 < largest_m < 1.0
    assert largest_rad < 0.03


def test_a_turn_that_no_pole_has_excluded_yet_widens_the_pose() -> None:
    before_m, before_rad = DetectorCheck(PolesConfig()).calibration_sd
    assert before_m > 0.2
    assert before_rad == pytest.approx(np.radians(1.0), rel=0.01)
    check, _ = drive(7)
    assert check.hinted_sd[0] == 0.0
    assert check.calibration_sd == (0.0, 0.0)
    turned, _ = drive(6, turn_rad=0.016)
    assert turned.calibration_sd[1] > np.hypot(turned.hinted_sd[1], 0.005)


@pytest.mark.parametrize(("turn_rad", "wide"), [(0.0, False), (0.03, True)])
def test_a_turn_that_many_poles_excluded_stays_so_unless_what_is_seen_says_another(
    turn_rad: float, wide: bool
) -> None:
    check, _ = drive(7)
    # 90 m further on there are two poles only, which tell a turn badly
    poles = np.array([[322.0, 6.0], [326.0, -5.0]])
    for k in range(10):
        pose = np.array([300.0 + k, 0.0, 0.0])
        seen = inverse_transform_points(pose, poles) @ rotation(turn_rad).T
        scan = scan_at(40.0 + 0.1 * k, seen)
        check.add_scan(scan, mapped(poles), pose, pose, 300.0 + k, (8.0, 0.0))
    assert check.fit is not None
    assert check.fit.sd[0] > 0.015
    assert (check.calibration_sd[1] > 0.003) == wide


@pytest.mark.parametrize(("turn_rad", "reason"), [(0.0, ""), (0.035, "turned"), (-0.035, "turned")])
def test_a_camera_that_sees_its_own_course_is_judged_within_few_metres(
    turn_rad: float, reason: str
) -> None:
    check = DetectorCheck(PolesConfig())
    for k in range(40):
        sample = OdometrySample(0.1 * k, 0.1 * k, 8.0, 0.0, 8.0 * np.tan(turn_rad))
        check.course.add_step(sample, 0.8 * k)
    # before any pole
    assert check.calibration_sd[1] == pytest.approx(np.radians(1.0 if turn_rad else 0.0), rel=0.01)
    poles = street(np.random.default_rng(1))
    for k in range(40):
        pose = np.array([0.8 * k, 0.0, 0.0])
        seen = inverse_transform_points(pose, poles)
        seen = seen[(seen[:, 0] > 3.0) & (seen[:, 0] < 25.0)]
        scan = scan_at(0.1 * k, seen @ rotation(turn_rad).T)
        check.add_scan(scan, mapped(poles), pose, pose, 0.8 * k, (8.0, 0.0))
        if k > 25:
            assert check.contradicts == reason


def test_a_finding_ends_when_the_stretch_excludes_it() -> None:
    _, found = drive(3, scale=0.9, until_m=70.0)
    assert "ranges" in found
    assert found[-1] == ""


def test_a_broken_path_is_no_evidence() -> None:
    check, _ = drive(1)
    check.forget()
    assert check.contradicts == ""
    assert set(KINDS) == {"turned", "ranges", "stamps"}


def test_scans_without_poles_are_taken() -> None:
    check = DetectorCheck(PolesConfig())
    landmarks, empty = mapped(np.empty((0, 2))), scan_at(0.0, np.empty((0, 2)))
    for k in range(30):
        pose = np.array([float(k), 0.0, 0.0])
        assert not check.add_scan(empty, landmarks, pose, pose, float(k), (1.0, 0.0))
    assert check.fit is None


def test_a_pose_that_drifts_where_no_pole_is_seen_accuses_nobody() -> None:
    check, found = drive(2)
    assert not check.contradicts
    landmarks = mapped(street(np.random.default_rng(2)))
    for k in range(80):
        way = 250.0 + 1.0 * k
        pose = np.array([way, 0.2 * k, 0.02 * k])
        empty = scan_at(30.0 + 0.1 * k, np.empty((0, 2)))
        check.add_scan(empty, landmarks, pose, np.array([way, 0.0, 0.0]), way, (10.0, 0.0))
    assert not check.contradicts
    assert found[-1] == ""


@pytest.mark.parametrize("seed", range(3))
def test_a_heading_that_is_lost_where_no_pole_is_seen_is_no_turn_of_the_detector(seed: int) -> None:
    check = Widest(PolesConfig())
    _, found = drive(seed, check, swerve_lost=0.05)
    assert set(found[15:]) == {""}
    assert check.widest_m < 0.17
