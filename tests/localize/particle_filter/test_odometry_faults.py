"""What odometry can do unseen: nothing on easy drives, within bounds on hard ones."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.samples import OdometrySample
from polemap.localize.config import LocalizeConfig
from polemap.localize.odometry_history import OdometryHistory
from polemap.localize.particle_filter.odometry_faults import OdometryFaults, demand
from polemap.localize.particle_filter.particles import ParticleSet

STEP_S = 0.02


def history(speed, rate):
    """Three seconds of odometry; speed and yaw rate of the time."""
    kept = OdometryHistory()
    for k in range(151):
        t = k * STEP_S
        kept.append(OdometrySample(t, t, speed(t), rate(t)))
    return kept


@pytest.mark.parametrize(
    ("speed", "rate", "expected"),
    [
        (lambda t: 10.0, lambda t: 0.0, (0.0, 0.0)),
        (lambda t: 5.0 + 2.0 * t, lambda t: 0.0, (2.0, 0.0)),
        (lambda t: 10.0, lambda t: 0.2, (2.0, 0.2)),
        # a bend that is just over counts for two seconds
        (lambda t: 10.0, lambda t: -0.3 if t < 1.8 else 0.0, (3.0, 0.3)),
        (lambda t: 10.0, lambda t: -0.3 if t < 0.8 else 0.0, (0.0, 0.0)),
    ],
    ids=["easy", "accelerating", "turning", "just turned", "turned long ago"],
)
def test_the_demand_is_the_largest_acceleration_of_two_seconds(speed, rate, expected):
    assert demand(history(speed, rate), 3.0) == pytest.approx(expected, abs=1e-9)


def test_easy_driving_makes_none_faulty_and_hard_driving_a_bounded_share():
    faults = OdometryFaults(20_000, np.random.default_rng(0))
    for _ in range(100):
        faults.step(0.1, 0.4, 0.05)
    assert not faults.faulty.any()
    shares = []
    for _ in range(300):
        faults.step(0.1, 5.0, 0.2)
        shares.append(faults.faulty.mean())
    assert shares[9] == pytest.approx(0.2, abs=0.04)  # after a second about 1 - exp(-0.2)
    assert shares[-1] == pytest.approx(0.4, abs=0.02)  # turns faulty 0.2 a second, sound 0.3
    assert faults.expected == pytest.approx(0.4, abs=0.02)
    assert faults.speed_share[faults.faulty].std() == pytest.approx(0.15, rel=0.05)
    assert faults.rate_radps[faults.faulty].std() == pytest.approx(0.03 + 0.4 * 0.2, rel=0.05)
    assert not faults.speed_share[~faults.faulty].any()
    assert not faults.rate_radps[~faults.faulty].any()


def test_the_spread_grows_with_what_the_car_asks_of_its_tyres():
    def spread_after(demand_mps2, turn_radps):
        config = LocalizeConfig(particles=4000)
        particles = ParticleSet(config, 2.7, np.random.default_rng(1))
        particles.place_all(np.zeros((4000, 3)), np.zeros(4000))
        kept = history(lambda t: 10.0, lambda t: turn_radps)
        for k in range(20):
            particles.faults.step(0.1, demand_mps2, turn_radps)
            arcs = kept.arcs(1.0 + 0.1 * k, 1.1 + 0.1 * k, 0.06)
            particles.move_along(arcs, 0.2 * np.ones(3))
        return particles.rear.std(axis=0)

    easy, hard = spread_after(0.3, 0.0), spread_after(2.0, 0.0)
    assert easy[0] < 0.15
    # a speed that is a tenth wrong since a second ago must lie within three standard deviations
    assert 1.0 / 3.0 < hard[0] < 1.5
    assert spread_after(2.0, 0.2)[2] > 2.0 * hard[2]


def test_particles_keep_their_opinion_when_they_are_drawn_anew():
    faults = OdometryFaults(4, np.random.default_rng(0))
    faults.faulty[:] = [True, False, True, False]
    faults.speed_share[:] = [0.1, 0.0, -0.2, 0.0]
    faults.take(np.array([2, 2, 1]))
    faults.join(5)
    assert faults.faulty.tolist() == [True, True, False, False, False]
    assert faults.speed_share.tolist() == [-0.2, -0.2, 0.0, 0.0, 0.0]
    assert len(faults.rate_radps) == 5


def test_poles_that_match_nothing_send_half_of_the_particles_around():
    particles = ParticleSet(LocalizeConfig(particles=2000), 2.7, np.random.default_rng(2))
    particles.place_all(np.tile([5.0, 7.0, 1.0], (2000, 1)), np.zeros(2000))
    particles.scatter(0.5, 20.0)
    moved = np.abs(particles.rear - [5.0, 7.0, 1.0]).sum(axis=1) > 1e-9
    assert moved.mean() == pytest.approx(0.5, abs=0.05)
    # a yaw that was wrong all the way has led aside by half of what it is wrong by at the end
    offset = particles.rear[moved] - [5.0, 7.0, 1.0]
    aside = -np.sin(1.0) * offset[:, 0] + np.cos(1.0) * offset[:, 1]
    assert np.corrcoef(aside, offset[:, 2])[0, 1] > 0.95
    assert offset[:, 2].std() == pytest.approx(0.25, rel=0.1)


def test_what_chance_makes_faulty_is_no_evidence():
    particles = ParticleSet(LocalizeConfig(particles=5000), 2.7, np.random.default_rng(3))
    particles.place_all(np.zeros((5000, 3)), np.zeros(5000))
    for _ in range(300):
        particles.faults.step(0.1, 5.0, 0.2, suspect=True)
    assert particles.faulty_share == pytest.approx(0.5 / 0.8, abs=0.03)
    assert particles.fault_evidence == pytest.approx(1.0, abs=0.15)
    # poles that favour the faulty by a factor are evidence of that factor
    particles.log_weights = np.where(particles.faults.faulty, np.log(20.0), 0.0)
    assert particles.fault_evidence == pytest.approx(20.0, rel=0.15)
