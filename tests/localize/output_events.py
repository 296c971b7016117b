"""Drives of points fed to the output filter, event by event."""

from dataclasses import replace

import numpy as np

from polemap.localize.output_filter.filter import OutputFilter
from polemap.localize.output_filter.noise_model import NoiseModel
from polemap.simulate.points.drive import POSES_IN_CITY, simulate_points
from polemap.vehicle.packed import unpack

CAR = NoiseModel()


def city_drive(seed, **changes):
    """Odometry, GNSS and poses of a drive through a city; `changes` are the scenario's."""
    return simulate_points(replace(POSES_IN_CITY, **changes), np.random.default_rng(seed))


def odometry_of(drive):
    stream = drive.drive.odometry
    return [stream.sample(row) for row in range(len(stream))]


def gnss_of(drive):
    stream = drive.drive.gnss
    return [stream.sample(row) for row in range(len(stream))]


def events_of(drive):
    """(arrival, kind, sample) of odometry and poses."""
    events = [(o.arrival_s, 0, o) for o in odometry_of(drive)]
    events += [(p.arrival_s, 1, p) for p in drive.poses]
    return sorted(events, key=lambda event: event[:2])


def give(output, kind, sample):
    if kind == 0:
        return output.add_odometry(sample.stamp_s, sample.speed_mps, sample.yaw_rate_radps)
    if kind == 1:
        return output.add_pose(sample.stamp_s, sample.pose, sample.covariance)
    return output.add_gnss(sample.stamp_s, sample.east_m, sample.north_m, sample.hdop)


def run(drive, config, events=None, noise=CAR):
    """Feed a drive and ask at 100 Hz; stamps, means (n, 7), covariances (n, 3, 3), the filter."""
    output = OutputFilter(config, noise=noise)
    stamps, means, covariances, tick = [], [], [], 0
    for arrival, kind, sample in events_of(drive) if events is None else events:
        while tick / 100 < arrival:
            if output.started:
                state = output.predicted_to(tick / 100)
                stamps.append(tick / 100)
                means.append(state.mean)
                covariances.append(unpack(state.upper)[:3, :3])
            tick += 1
        give(output, kind, sample)
    return np.array(stamps), np.array(means), np.array(covariances), output


def started_with_odometry(config, seconds=2.0, speed=10.0, noise=CAR):
    output = OutputFilter(config, noise=noise)
    output.add_pose(0.0, np.array([0.0, 0.0, 0.0]), np.diag([0.01, 0.01, 1e-4]))
    for step in range(1, round(seconds * 50) + 1):
        output.add_odometry(step * 0.02, speed, 0.0)
    return output
