from __future__ import annotations

import numpy as np
import pytest

from polemap.localize.place.local_map import LocalMap
from polemap.localize.place.local_map_builder import LocalMapBuilder
from polemap.vehicle.pose import inverse_transform_points, relative, transform_points
from tests.pole_maps import plain_scan

POLES = np.random.default_rng(4).uniform((-5.0, -12.0), (75.0, 12.0), (30, 2))


def driven(
    scale: float = 1.0, curvature: float = 0.0, noise_m: float = 0.0, reach_m: float = 20.0
) -> LocalMap:
    """Along 50 m of a straight street with odometry that errs."""
    rng = np.random.default_rng(5)
    builder = LocalMapBuilder()
    for way in np.arange(0.0, 50.0, 1.0):
        seen = inverse_transform_points(np.array([way, 0.0, 0.0]), POLES)
        seen = seen[(np.hypot(*seen.T) < reach_m) & (seen[:, 0] > 0.0)]
        seen = seen + noise_m * rng.standard_normal(seen.shape)
        told = way / scale
        bend = -curvature * way
        pose = np.array([told * np.cos(0.5 * bend), told * np.sin(0.5 * bend), bend])
        builder.add_scan(plain_scan(way / 8.0, seen), pose, told)
    made = builder.local_map()
    assert made is not None
    made = builder.local_map()
    assert made is not None
    return made.confirmed()


def errors(made: LocalMap) -> np.ndarray:
    truth = inverse_transform_points(np.array([49.0, 0.0, 0.0]), POLES)
    distance = np.hypot(*(made.points_m[:, np.newaxis] - truth).transpose(2, 0, 1))
    return distance.min(axis=1)


def test_poles_stand_where_they_were_seen() -> None:
    made = driven()
    assert len(made) > 15
    assert errors(made).max() < 1e-6


@pytest.mark.parametrize(("scale", "curvature"), [(1.04, 0.0), (0.97, 0.0), (1.0, 0.0015)])
def test_lasting_errors_of_the_odometry_are_learned_from_poles(
    scale: float, curvature: float
) -> None:
    made = driven(scale, curvature)
    # all of them move by up to 2 m where nothing is learned
    assert errors(made).max() < 0.1


def test_errors_are_as_large_as_stated() -> None:
    made = driven(noise_m=0.1, scale=1.02)
    spread = made.covariance_m2 + made.drift @ made.drift_covariance @ made.drift.transpose(0, 2, 1)
    sd = np.sqrt(np.trace(spread, axis1=1, axis2=2))
    assert np.median(errors(made) / sd) < 1.2
    assert (errors(made) < 4.0 * sd).all()


def test_what_is_unknown_of_the_odometry_grows_with_the_way() -> None:
    made = driven()
    spread = np.einsum("nia,ab,nib->n", made.drift, made.drift_covariance, made.drift)
    near, far = np.argmin(np.abs(made.points_m[:, 0])), np.argmin(made.points_m[:, 0])
    assert spread[far] > spread[near]


def test_a_standing_car_adds_nothing() -> None:
    builder = LocalMapBuilder()
    assert builder.local_map() is None
    assert builder.add_scan(plain_scan(0.0, POLES[:3]), np.zeros(3), 0.0)
    assert not builder.add_scan(plain_scan(1.0, POLES[:3]), np.zeros(3), 0.1)
    made = builder.local_map()
    assert made is not None
    assert made.sightings.tolist() == [1, 1, 1]


def test_scans_without_poles_are_looks_too() -> None:
    builder = LocalMapBuilder()
    for way in range(3):
        assert builder.add_scan(plain_scan(way, np.empty((0, 2))), np.zeros(3), float(way))
    assert builder.local_map() is None


def test_what_lies_far_behind_is_forgotten() -> None:
    builder = LocalMapBuilder(window_m=20.0)
    for way in np.arange(0.0, 60.0, 1.0):
        pose = np.array([way, 0.0, 0.0])
        seen = inverse_transform_points(pose, POLES)
        builder.add_scan(plain_scan(way, seen[np.hypot(*seen.T) < 8.0]), pose, float(way))
    made = builder.local_map()
    assert made is not None
    assert made.points_m[:, 0].min() > -30.0
    assert made.way_m == pytest.approx(20.0)


def test_scans_of_which_no_map_was_asked_make_the_same_map() -> None:
    rng = np.random.default_rng(6)
    asked, unasked = LocalMapBuilder(window_m=20.0), LocalMapBuilder(window_m=20.0)
    for way in np.arange(0.0, 60.0, 1.0):
        pose = np.array([way, 0.0, 0.0])
        seen = inverse_transform_points(pose, POLES) + 0.1 * rng.standard_normal(POLES.shape)
        scan = plain_scan(way, seen[np.hypot(*seen.T) < 8.0])
        for builder in (asked, unasked):
            builder.add_scan(scan, pose, float(way))
        asked._drift = np.zeros(3)
        often = asked.local_map()
    once = unasked.local_map()
    assert often is not None
    assert once is not None
    # in another order: numbers are given out as poles are met
    mine, theirs = np.argsort(once.points_m[:, 0]), np.argsort(often.points_m[:, 0])
    np.testing.assert_allclose(once.points_m[mine], often.points_m[theirs], atol=1e-12)
    np.testing.assert_array_equal(once.sightings[mine], often.sightings[theirs])


def test_the_mirror_image_is_the_other_side_of_the_street() -> None:
    made = driven(noise_m=0.05)
    mirrored = made.mirrored()
    np.testing.assert_array_equal(mirrored.points_m, made.points_m * (1.0, -1.0))
    np.testing.assert_allclose(mirrored.mirrored().covariance_m2, made.covariance_m2)
    seen = transform_points(made.looks[0], np.array([[5.0, 2.0]]))
    other = transform_points(mirrored.looks[0], np.array([[5.0, -2.0]]))
    np.testing.assert_allclose(other, seen * (1.0, -1.0))


def test_looks_lie_in_the_frame_of_the_newest() -> None:
    made = driven()
    np.testing.assert_allclose(made.looks[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(relative(made.looks[0], made.looks[-1]), [49.0, 0.0, 0.0], atol=1e-6)
