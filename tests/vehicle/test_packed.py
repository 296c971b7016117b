"""The core in plain floats against its array forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.vehicle import motion, packed, pose
from polemap.vehicle.kalman import innovate, joseph_update
from polemap.vehicle.packed import (
    INDEX,
    CtrvNoise,
    GaussMarkov,
    ctrv_predict,
    pack,
    unpack,
    update_by_two,
    wrap,
)
from polemap.vehicle.pose import wrap_angle
from tests.vehicle.ctrv_arrays import ctrv_jacobian, ctrv_process_noise, ctrv_step

SCALE, OFFSET, FIX = GaussMarkov(0.03, 40.0), GaussMarkov(0.005, 25.0), GaussMarkov(2.5, 6.0)
NOISE = CtrvNoise(
    2.0, 0.3, 1e-4, along_s=2e-4, yaw_rad2ps=1e-5, turn_s=3e-4,
    scale=SCALE, offset_radps=OFFSET, fix_m=FIX,
)  # fmt: skip
WRONG = (0.02, 0.003, 1.5, -0.7)
rates = st.one_of(st.floats(-3.0, 3.0), st.sampled_from([0.0, 1e-12, -1e-12, 1e-7, 4.9, 5.1]))


def random_covariance(seed):
    root = np.random.default_rng(seed).normal(size=(9, 9))
    return root @ root.T + 0.1 * np.eye(9)


def test_packing_keeps_every_entry():
    covariance = random_covariance(1)
    packed = pack(covariance)
    assert len(packed) == 45
    assert np.array_equal(unpack(packed), covariance)
    assert all(packed[INDEX[i][j]] == covariance[i, j] for i in range(9) for j in range(9))


lengths = st.floats(-1e3, 1e3)
turns = st.one_of(st.floats(-3.0, 3.0), st.sampled_from([0.0, 1e-12, -1e-9, 1.9e-8, 2.1e-8]))
planar = st.tuples(lengths, lengths, st.floats(-3.1, 3.1))


@given(planar, planar)
def test_poses_equal_the_array_forms(a, b):
    x, y, _ = b
    for plain, array in (
        (packed.rotate(x, y, a[2]), pose.rotate([x, y], a[2])),
        (packed.rotate_back(x, y, a[2]), pose.rotate_back([x, y], a[2])),
        (packed.transform_point(a, x, y), pose.transform_points(a, [x, y])),
    ):
        assert np.allclose(plain, array, atol=1e-9)
    for plain, array in (
        (packed.compose(a, b), pose.compose(a, b)),
        (packed.inverse(a), pose.inverse(a)),
    ):
        assert np.allclose(plain[:2], array[:2], atol=1e-9)
        assert wrap_angle(plain[2] - array[2]) == pytest.approx(0.0, abs=1e-12)
        assert -np.pi <= plain[2] < np.pi


@given(st.floats(-3.1, 3.1), lengths, turns, st.floats(-0.1, 0.1))
def test_arcs_equal_the_array_form(yaw, distance, turn, sideslip):
    plain = packed.arc_displacement(yaw, distance, turn, sideslip)
    assert np.allclose(plain, motion.arc_displacement(yaw, distance, turn, sideslip), atol=1e-10)


@given(
    st.integers(0, 10_000),
    st.floats(-3.1, 3.1),
    st.floats(-20.0, 40.0),
    rates,
    st.floats(0.0, 0.5),
    st.sampled_from([0.0, 0.006]),
)
def test_prediction_equals_the_array_form(seed, yaw, speed, rate, dt, slip):
    covariance = random_covariance(seed)
    mean = (3.0, -4.0, yaw, speed, rate, *WRONG)
    moved, upper = ctrv_predict(mean, pack(covariance), dt, NOISE, slip)
    state = np.array(mean[:5])
    transition, added = np.eye(9), np.zeros((9, 9))
    transition[:5, :5] = ctrv_jacobian(state, dt, slip)
    added[:5, :5] = ctrv_process_noise(
        state,
        dt,
        acceleration_m2ps3=2.0,
        yaw_acceleration_rad2ps3=0.3,
        lateral_m2ps=1e-4 * (speed**2 * rate) ** 2,
        along_m2ps=2e-4 * speed**2,
        yaw_rad2ps=1e-5 * min(1.0, speed**2) + 3e-4 * rate**2,
        slip_rad_per_mps2=slip,
    )
    kept = np.exp([-dt / error.time_s for error in (SCALE, OFFSET, FIX, FIX)])
    variance = np.array([error.sd**2 for error in (SCALE, OFFSET, FIX, FIX)])
    transition[5:, 5:] = np.diag(kept)
    added[5:, 5:] = np.diag((1.0 - kept**2) * variance)
    expected = transition @ covariance @ transition.T + added
    scale = max(1.0, np.abs(expected).max())
    assert np.allclose(unpack(upper), expected, rtol=1e-12, atol=1e-12 * scale)
    stepped = ctrv_step(state, dt, slip)
    assert np.allclose(moved[:2], stepped[:2], atol=1e-11)
    assert wrap_angle(moved[2] - stepped[2]) == pytest.approx(0, abs=1e-12)
    assert moved[3:5] == mean[3:5]
    assert np.allclose(moved[5:], kept * WRONG, rtol=1e-12)
    alone = packed.ctrv_step(mean[:3], speed, rate, dt, slip)
    assert np.allclose(alone, moved[:3], atol=1e-11)


@pytest.mark.parametrize(("speed", "rate"), [(9.0, 0.4), (-3.0, 0.2), (12.0, -0.05)])
def test_a_slipping_rear_axle_goes_aside_of_where_the_car_points(speed, rate):
    slip, dt, quiet = 0.006, 0.3, CtrvNoise(0.0, 0.0, 0.0)
    mean = np.array([3.0, -4.0, 0.7, speed, rate, 0.0, 0.0, 0.0, 0.0])

    def moved(state):
        return np.array(
            ctrv_predict(tuple(state.tolist()), pack(np.zeros((9, 9))), dt, quiet, slip)[0]
        )

    turned = mean.copy()
    turned[2] -= slip * speed * rate
    plain = np.array(ctrv_predict(tuple(turned.tolist()), pack(np.zeros((9, 9))), dt, quiet)[0])
    assert np.allclose(moved(mean)[:2], plain[:2], atol=1e-12)
    assert moved(mean)[2] == pytest.approx(mean[2] + rate * dt)
    assert np.allclose(
        packed.ctrv_step(tuple(mean[:3].tolist()), speed, rate, dt, slip),
        moved(mean)[:3],
        atol=1e-12,
    )
    jacobian = np.stack([(moved(mean + h) - moved(mean - h)) / 2e-6 for h in 1e-6 * np.eye(9)], 1)
    covariance = random_covariance(5)
    _, upper = ctrv_predict(tuple(mean.tolist()), pack(covariance), dt, quiet, slip)
    assert np.allclose(unpack(upper), jacobian @ covariance @ jacobian.T, rtol=1e-6, atol=1e-6)


@given(
    st.integers(0, 10_000), st.sampled_from([(3, 1.02, 5, 9.0), (4, 1.0, 6, 1.0), (3, 1.0, 5, 0)])
)
def test_an_update_equals_the_array_form(seed, row):
    covariance = random_covariance(seed)
    mean = (3.0, -4.0, 0.3, 9.0, 0.1, *WRONG)
    jacobian = np.zeros((1, 9))
    jacobian[0, row[0]], jacobian[0, row[2]] = row[1], row[3]
    noise = np.array([[0.04]])
    innovation = innovate(np.array([0.2]), covariance, jacobian, noise)
    expected, expected_p = joseph_update(np.array(mean), covariance, innovation, jacobian, noise)
    expected[2] = wrap_angle(expected[2])
    after, upper = update_by_two(mean, pack(covariance), row, 0.2, 0.04)
    assert np.allclose(after, expected, rtol=1e-11, atol=1e-12)
    assert np.allclose(unpack(upper), expected_p, rtol=1e-9, atol=1e-10)
    assert np.linalg.eigvalsh(unpack(upper)).min() > 0.0


@given(st.floats(-50.0, 50.0))
def test_wrapping_equals_the_array_form(angle):
    assert wrap_angle(wrap(angle) - wrap_angle(angle)) == pytest.approx(0.0, abs=1e-13)
    assert -np.pi <= wrap(angle) < np.pi


def test_gauss_markov_errors_stay_within_their_bounds_and_forget():
    mean, upper = (0.0, 0.0, 0.0, 10.0, 0.0, *WRONG), pack(1e-6 * np.eye(9))
    for _ in range(400):
        mean, upper = ctrv_predict(mean, upper, 1.0, NOISE)
    assert np.allclose(mean[5:], 0.0, atol=1e-3)
    sd = np.sqrt(np.diag(unpack(upper))[5:])
    assert np.allclose(sd, [0.03, 0.005, 2.5, 2.5], rtol=1e-6)
