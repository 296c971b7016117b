"""Position and heading from fixes laid onto the dead-reckoned path."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.samples import GnssFix
from polemap.localize.config import GnssConfig
from polemap.localize.gnss.alignment import GnssAlignment, GnssPose
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.vehicle.pose import wrap_angle

RECEIVER = GnssReceiver((1.2, 0.3))


def drive_and_fix(
    align: GnssAlignment,
    pose0: np.ndarray,
    sd_m: float,
    rng: np.random.Generator,
    *,
    count: int = 30,
    outliers: tuple[int, ...] = (),
    jump: tuple[int, float] = (10_000, 0.0),
) -> tuple[np.ndarray, np.ndarray]:
    """Drive an S; dead reckoning starts at the origin. Returns its last pose and the true one."""
    lasting = rng.normal(0, sd_m, 2)
    odometry_pose = np.zeros(3)
    true = pose0.copy()
    for k in range(count):
        way, turn = 6.0, 0.03 * np.sin(k / 5)
        for pose in (odometry_pose, true):
            pose[0] += way * np.cos(pose[2] + turn / 2)
            pose[1] += way * np.sin(pose[2] + turn / 2)
            pose[2] += turn
        if k == jump[0]:
            true[:2] += jump[1]
        c, s = np.cos(true[2]), np.sin(true[2])
        antenna = true[:2] + np.array([1.2 * c - 0.3 * s, 1.2 * s + 0.3 * c])
        fix = antenna + lasting + rng.normal(0, 0.3, 2)
        if k in outliers:
            fix = fix + rng.choice([-1.0, 1.0], 2) * rng.uniform(80, 200, 2)
        align.add_fix(
            GnssFix(float(k), float(k), float(fix[0]), float(fix[1]), 1.0),
            odometry_pose.copy(),
        )
    return odometry_pose, true


@pytest.mark.parametrize("outliers", [(), (3, 4, 11, 20, 28, 29)])
def test_alignment_finds_position_and_heading(outliers: tuple[int, ...]) -> None:
    errors = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        align = GnssAlignment(RECEIVER)
        pose0 = np.array([*rng.uniform(-50, 50, 2), rng.uniform(-np.pi, np.pi)])
        odometry_pose, true = drive_and_fix(align, pose0, 2.5, rng, outliers=outliers)
        found = align.align(odometry_pose)
        assert found is not None
        assert found.heading_known
        error = found.pose - true
        error[2] = wrap_angle(error[2])
        errors.append(error)
        assert abs(error[2]) < 5 * np.sqrt(found.covariance[2, 2])
    errors = np.array(errors)
    # the lasting error of 2.5 m in each axis stays, and hardly more
    rms = np.sqrt((errors**2).mean(axis=0))
    assert 2.5 * 0.75 < rms[0] < 2.5 * 1.3
    assert 2.5 * 0.75 < rms[1] < 2.5 * 1.3
    assert rms[2] < 0.03


def test_alignment_follows_a_car_that_was_moved() -> None:
    rng = np.random.default_rng(0)
    align = GnssAlignment(RECEIVER)
    odometry_pose, true = drive_and_fix(align, np.zeros(3), 0.0, rng, jump=(26, 50.0))
    # three fixes of one second each lie beyond the jump, within the last two seconds
    found = align.align(odometry_pose)
    assert found is not None
    assert np.hypot(*(found.pose[:2] - true[:2])) < 5.0


def test_a_standing_car_has_no_heading() -> None:
    align = GnssAlignment(RECEIVER)
    rng = np.random.default_rng(0)
    assert align.align(np.zeros(3)) is None
    for k in range(20):
        e, n = rng.normal(0, 0.3, 2)
        align.add_fix(GnssFix(float(k), float(k), 10 + e, 20 + n, 1.0), np.zeros(3))
    found = align.align(np.zeros(3))
    assert found is not None
    assert not found.heading_known
    assert np.hypot(found.pose[0] - 10, found.pose[1] - 20) < 1.0
    yaw = found.sample(2000, rng)[:, 2]
    assert np.abs(np.exp(1j * yaw).mean()) < 5 / np.sqrt(2000)


def test_what_gnss_says_against_a_pose() -> None:
    gnss = GnssPose(np.array([100.0, 50.0, 3.1]), np.diag([4.0, 9.0, 0.01]), True)
    at = np.array([[100.0, 50.0, 3.1], [102.0, 50.0, 3.1], [100.0, 53.0, 3.1], [100.0, 50.0, -3.1]])
    turned = wrap_angle(np.array(6.2))
    expected = [0.0, 0.5, 0.5, 0.5 * float(turned) ** 2 / 0.01]
    said = gnss.misfit(at, GnssReceiver(config=GnssConfig(outlier_share=1e-6)))
    np.testing.assert_allclose(said - said[0], expected, atol=1e-4)
    # a receiver may be wrong altogether: a kilometre says no more than a hundred metres, nearly
    far = gnss.misfit(np.array([[140.0, 50.0, 3.1], [160.0, 50.0, 3.1]]), RECEIVER)
    assert 6.0 < far[0] < far[1] < 10.0
    # and says nothing of a heading that it does not know
    blind = GnssPose(gnss.pose, gnss.covariance, False)
    assert blind.misfit(np.array([[100.0, 50.0, 0.0]]), RECEIVER) == blind.misfit(at[:1], RECEIVER)
