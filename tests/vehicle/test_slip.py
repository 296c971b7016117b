import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.vehicle.io import car_names, load_car
from polemap.vehicle.motion import sideslip_at, velocity_at
from polemap.vehicle.single_track import lateral

speeds, rates, arms = st.floats(1.0, 40.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0)


@given(speeds, rates, arms, arms)
def test_the_velocity_of_another_point_is_the_derivative_of_its_place(vx, rate, ahead, left):
    step = 1e-6

    def place(t):
        turned = rate * t
        c, s = np.cos(turned), np.sin(turned)
        return np.array([vx * t + c * ahead - s * left, 0.3 * t + s * ahead + c * left])

    numeric = (place(step) - place(-step)) / (2 * step)
    assert np.allclose(velocity_at(vx, 0.3, rate, ahead, left), numeric, atol=1e-6)
    there_and_back = velocity_at(*velocity_at(vx, 0.3, rate, ahead, left), rate, -ahead, -left)
    assert np.allclose(there_and_back, (vx, 0.3))


@given(speeds, rates, arms)
def test_small_sideslip_at_another_point_is_that_of_its_velocity(speed, rate, ahead):
    vx, vy = velocity_at(speed, 0.02 * speed, rate, ahead)
    assert sideslip_at(0.02, rate, speed, ahead) == pytest.approx(vy / vx)


@pytest.mark.parametrize("name", car_names())
def test_slip_per_lateral_acceleration_is_the_steady_state_of_the_single_track(name):
    """Both axles in a steady bend at 15 m/s, and the steering that holds it."""
    car, speed = load_car(name), 15.0
    a, b = lateral(car, speed)
    steering = 0.01
    beta, rate = np.linalg.solve(a, -b[:, 0] * steering)
    lateral_mps2 = speed * rate
    rear = sideslip_at(beta, rate, speed, -car.cg_to_rear_m)
    front = sideslip_at(beta, rate, speed, car.cg_to_front_m) - steering
    assert rear / lateral_mps2 == pytest.approx(-car.rear_slip_rad_per_mps2)
    assert front / lateral_mps2 == pytest.approx(-car.front_slip_rad_per_mps2)
    curvature = rate / speed
    held = (car.wheelbase_m + car.understeer_s2pm * speed**2) * curvature
    assert held == pytest.approx(steering)
