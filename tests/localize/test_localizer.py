import math
import threading
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.samples import GnssFix, OdometrySample, ReferencePose, StereoFrame
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.output_filter.config import OutputConfig
from polemap.vehicle.kalman import chi_square_gate
from polemap.vehicle.pose import Pose2D
from tests.localize.point_drives import street_drive

CONFIG = LocalizeConfig(particles=300)
DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def street():
    # enough poles and GNSS that finding the first position is not what is tested here
    return street_drive(3, duration_s=15.0)


def inputs(street):
    """Odometry, fixes and scans by arrival."""
    drive = street.drive
    samples = [drive.odometry.sample(i) for i in range(len(drive.odometry))]
    samples += [drive.gnss.sample(i) for i in range(len(drive.gnss))]
    return sorted([*samples, *street.scans], key=lambda sample: sample.arrival_s)


def make(street, config=CONFIG, **options):
    return Localizer(
        street.pole_map, config, street.drive.wheelbase_m, np.random.default_rng(0), **options
    )


def run(street, samples, **options):
    """Push all, asking at 100 Hz; stamps, positions, the localizer, and the answers."""
    localizer = make(street, **options)
    answers, tick = [], 0
    for sample in samples:
        while tick / 100 < sample.arrival_s:
            answers.append(localizer.pose_at(tick / 100))
            tick += 1
        localizer.add_sample(sample)
    return [answer for answer in answers if answer is not None], localizer


def errors(street, answers):
    stamps = np.array([answer.stamp_s for answer in answers])
    poses = np.array([answer.pose[:2] for answer in answers])
    return stamps, np.hypot(*(poses - street.motion.at(stamps)[:, :2]).T)


def steps(answers):
    """How far each tick's output is from where speed and yaw rate lead the last one."""
    jumps = []
    for before, after in pairwise(answers):
        if after.flag:
            continue
        dt = after.stamp_s - before.stamp_s
        heading = before.pose[2] + 0.5 * after.yaw_rate_radps * dt
        x = before.pose[0] + after.speed_mps * dt * math.cos(heading)
        y = before.pose[1] + after.speed_mps * dt * math.sin(heading)
        jumps.append(math.hypot(after.pose[0] - x, after.pose[1] - y))
    return np.array(jumps)


@pytest.fixture(scope="module")
def good(street):
    return run(street, inputs(street))


def test_a_healthy_drive_is_followed(street, good):
    answers, localizer = good
    stamps, error = errors(street, answers)
    assert np.median(error[stamps > 8.0]) < 0.15
    counts = localizer.summary()
    assert counts["poses_accepted"] > 50
    assert not any(kind in key for key in counts for kind in ("future", "backwards", "duplicate"))


def test_asking_twice_is_asking_the_filter(good):
    answers, localizer = good
    last = answers[-1].stamp_s
    past = localizer.pose_at(last - 0.2)
    assert past is not None
    assert past.flag == ""
    assert localizer.pose_at(-100.0) is None


def test_before_any_position_there_is_no_pose(street):
    localizer = make(street)
    assert localizer.pose_at(0.0) is None
    localizer.add_sample(OdometrySample(0.0, 0.0, 5.0, 0.0))
    assert localizer.pose_at(0.01) is None


def test_reference_poses_are_no_input(street):
    localizer = make(street)
    localizer.add_sample(ReferencePose(0.0, Pose2D(0.0, 0.0, 0.0), 0.01))
    assert localizer.pose_at(1.0) is None


def test_a_frame_without_perception_is_refused(street):
    image = np.zeros((4, 4), dtype=np.uint8)
    with pytest.raises(InputError, match="has no perception"):
        make(street).add_sample(StereoFrame(0.0, 0.0, 0, image, image))


def damage_nan(samples):
    return [
        replace(s, speed_mps=math.nan) if isinstance(s, OdometrySample) and i % 50 == 0 else s
        for i, s in enumerate(samples)
    ]


def damage_nan_gnss(samples):
    return [replace(s, east_m=math.inf) if isinstance(s, GnssFix) else s for s in samples]


def damage_duplicates(samples):
    return [s for sample in samples for s in (sample, sample)]


def damage_order(samples):
    rng = np.random.default_rng(0)
    late = [s.arrival_s + rng.uniform(0.0, 0.1) for s in samples]
    return [
        replace(samples[i], arrival_s=late[i])
        for i in sorted(range(len(late)), key=late.__getitem__)
    ]


def damage_future(samples):
    return [
        replace(s, stamp_s=s.stamp_s + 5.0) if isinstance(s, OdometrySample) and i % 40 == 0 else s
        for i, s in enumerate(samples)
    ]


def damage_too_old(samples):
    return [
        replace(s, stamp_s=s.stamp_s - 0.4) if isinstance(s, OdometrySample) and i % 40 == 0 else s
        for i, s in enumerate(samples)
    ]


@pytest.mark.parametrize(
    ("damage", "counted"),
    [
        (damage_nan, "odometry_not_finite"),
        (damage_nan_gnss, "gnss_not_finite"),
        (damage_duplicates, "odometry_duplicate"),
        (damage_future, "odometry_future"),
        (damage_too_old, "odometry_too_old"),
        (damage_order, None),
    ],
)
def test_bad_input_is_counted_and_does_no_harm(street, damage, counted):
    config = CONFIG.model_copy(
        update={"output": OutputConfig(horizon_s=0.3 if counted == "odometry_too_old" else 1.0)}
    )
    answers, localizer = run(street, damage(inputs(street)), config=config)
    stamps, error = errors(street, answers)
    assert np.median(error[stamps > 8.0]) < 0.25
    assert all(np.isfinite(answer.covariance).all() for answer in answers)
    if counted is not None:
        assert localizer.summary()[counted] > 0


def test_a_silent_sensor_is_counted_and_bridged(street):
    samples = [
        s for s in inputs(street) if not (isinstance(s, OdometrySample) and 9.0 < s.stamp_s < 10.0)
    ]
    answers, localizer = run(street, samples)
    assert localizer.summary()["odometry_silences"] == 1
    stamps = np.array([answer.stamp_s for answer in answers])
    assert np.allclose(np.diff(stamps), 0.01, atol=1e-9)
    assert steps(answers).max() < 0.2


def test_poses_whose_covariance_is_none_are_dropped(street):
    localizer = make(street)
    samples = inputs(street)
    for sample in samples[:600]:
        localizer.add_sample(sample)
    before = localizer.pose_at(samples[599].arrival_s + 0.01)
    broken = None
    for sample in samples[600:]:
        if sample in street.scans:
            # the particle filter's answer, damaged on its way to the output filter
            estimate = localizer._particle_filter.process_scan(sample)
            broken = replace(estimate, covariance=-np.eye(3))
            break
    assert broken is not None
    assert localizer._poses._offer(broken)[0] == "dropped:bad_covariance"
    assert localizer.summary()["pose_bad_covariance"] == 1
    after = localizer.pose_at(samples[599].arrival_s + 0.02)
    assert before is not None
    assert after is not None
    assert math.dist(before.pose[:2], after.pose[:2]) < 0.5


def test_updates_are_told_with_their_fate(street):
    updates = []
    _, localizer = run(street, inputs(street), on_update=updates.append)
    accepted = sum(update.decision == "accepted" for update in updates)
    counts = localizer.summary()
    assert counts["poses_accepted"] == accepted
    assert {update.decision.split(":")[0] for update in updates} <= {
        "accepted",
        "ignored",
        "inflated",
        "vetoed",
        "reinitialized",
        "started",
        "not_offered",
        "dropped",
    }
    # three degrees of freedom: a pose is taken below the gate, and ignored above it
    limit = chi_square_gate(LocalizeConfig().output.pose_gate, 3)
    assert all(0.0 < u.nis <= limit for u in updates if u.decision == "accepted")
    assert all(u.nis > limit for u in updates if u.decision in ("ignored", "inflated"))
    assert all(math.isnan(u.nis) for u in updates if u.decision[:3] in ("not", "dro", "sta"))
    assert all(math.isnan(u.update_s) and math.isnan(u.offer_s) for u in updates)


def test_two_threads_may_add_and_ask(street):
    """One thread drives, one asks all the time; the answers are poses of the same drive."""
    localizer = make(street)
    answers, failures, done, now = [], [], threading.Event(), [0.0]

    def ask():
        try:
            while not done.is_set():
                answer = localizer.pose_at(now[0])
                if answer is not None:
                    answers.append(answer)
                time.sleep(0.0005)
        except Exception as error:
            failures.append(error)

    thread = threading.Thread(target=ask)
    thread.start()
    for sample in inputs(street):
        localizer.add_sample(sample)
        now[0] = sample.arrival_s
    done.set()
    thread.join()
    assert not failures
    # what was added decides, not who asked meanwhile: the filter's state is the same
    assert localizer._filter.newest.mean == pytest.approx(
        _after(street)._filter.newest.mean, abs=1e-12
    )
    assert answers


def _after(street):
    localizer = make(street)
    for sample in inputs(street):
        localizer.add_sample(sample)
    return localizer


def test_a_known_place_is_believed_and_found_at_once(street):
    localizer = make(street)
    samples = [s for s in inputs(street) if not isinstance(s, GnssFix)]
    first = next(s for s in samples if isinstance(s, Detections))
    true = street.motion.at(np.array([first.stamp_s]))[0, :3]
    with pytest.raises(InputError, match=r"at 0\.0 s cannot be used \(not_finite"):
        localizer.start_at(0.0, np.full(3, np.nan), np.eye(3))
    localizer.start_at(first.stamp_s - 0.01, true, np.diag([0.04, 0.04, 1e-4]))
    estimates = [localizer.add_sample(s) for s in samples if s.arrival_s <= first.arrival_s]
    assert estimates[-1] is not None
    assert estimates[-1].event is None
    assert np.hypot(*(estimates[-1].pose - true)[:2]) < 0.5
    blind = Localizer(None, CONFIG, 2.7, np.random.default_rng(0))
    with pytest.raises(InputError, match="start_at: this localizer has no map"):
        blind.start_at(0.0, np.zeros(3), np.eye(3))
