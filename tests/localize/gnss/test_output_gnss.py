import math

import numpy as np
import pytest

from polemap.localize.gnss.start import START_YAW_SD_RAD
from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.filter import OutputFilter
from polemap.vehicle.pose import wrap_angle
from tests.localize.output_events import city_drive, give, gnss_of, odometry_of, run


def gnss_drive(seed, **changes):
    drive = city_drive(seed, duration_s=25.0, **changes)
    events = [(o.arrival_s, 0, o) for o in odometry_of(drive)]
    events += [(fix.arrival_s, 2, fix) for fix in gnss_of(drive)]
    return drive, sorted(events, key=lambda event: event[:2])


@pytest.mark.parametrize("seed", range(3))
def test_gnss_starts_the_filter_once_the_heading_shows(seed):
    drive, events = gnss_drive(seed)
    stamps, means, covariances, output = run(drive, OutputConfig(), events)
    assert output.started
    true = drive.motion.at(stamps)
    # at the start the heading is known to the configured sd, the position to that of GNSS
    assert abs(wrap_angle(means[0, 2] - true[0, 2])) < 4 * math.sqrt(covariances[0, 2, 2])
    assert math.sqrt(covariances[0, 2, 2]) <= START_YAW_SD_RAD + 0.01
    assert np.hypot(*(means[:, :2] - true[:, :2]).T).max() < 4 * 2.5 * 1.5
    assert output.newest.counts.gnss_accepted > 5


def test_the_first_pose_that_fits_takes_over_from_gnss():
    drive, events = gnss_drive(5)
    output = OutputFilter(OutputConfig())
    for _, kind, sample in events:
        give(output, kind, sample)
    stamp = output.newest.stamp_s
    wrong = drive.motion.at(stamp)[0, :3] + [40.0, 0.0, math.pi]
    output.add_pose(stamp + 0.01, wrong, np.diag([0.01, 0.01, 1e-4]))
    assert output.newest.decision == "ignored"
    true = drive.motion.at(stamp)[0, :3]
    output.add_pose(stamp + 0.02, true, np.diag([0.01, 0.01, 1e-4]))
    assert output.newest.decision == "started"
    assert output.newest.counts.takeovers == 1
    assert np.allclose(output.newest.mean[:2], true[:2], atol=0.01)


def test_a_filter_that_gnss_contradicts_for_long_starts_anew():
    drive, events = gnss_drive(6)
    output = OutputFilter(OutputConfig())
    wrong = drive.motion.at(0.0)[0, :3] + [200.0, 0.0, 2.0]
    output.add_pose(0.0, wrong, np.diag([0.01, 0.01, 1e-4]))
    for _, kind, sample in events:
        give(output, kind, sample)
    assert output.newest.counts.gnss_restarts == 1
    error = np.array(output.newest.mean[:2]) - drive.motion.at(output.newest.stamp_s)[0, :2]
    assert np.hypot(*error) < 4 * 2.5 * 1.5
