"""What faults do to the output: wrong poses, gaps, bursts and clocks that jump.

`python -m benchmarks.localize.output_filter_faults` prints the table of docs/output_filter.md. Not
timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import show
from benchmarks.localize.output_filter import Event, city_drive, events_of
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.particle_filter.estimate import HealthRecord, PfEstimate
from polemap.simulate.points.drive import PointDrive
from polemap.simulate.points.pose_source import PointPose
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import compose

Floats = NDArray[np.float64]
Fault = Callable[[PointDrive, list[Event]], list[Event]]
"""Changes the events of a drive from `_FROM_S` on."""

_FROM_S = 10.0


def _wrong_for(seconds: float, turned_rad: float = math.pi / 2) -> Fault:
    def fault(_drive: PointDrive, events: list[Event]) -> list[Event]:
        changed = []
        for arrival, kind, sample in events:
            if kind == 1 and _FROM_S <= sample.stamp_s < _FROM_S + seconds:
                # 10 m beside the truth and turned, as sure of itself as ever
                aside = compose(sample.pose, [0.0, 10.0, turned_rad])
                sample = replace(sample, pose=aside)
            changed.append((arrival, kind, sample))
        return changed

    return fault


def _gap(kind_of: int, seconds: float) -> Fault:
    def fault(_drive: PointDrive, events: list[Event]) -> list[Event]:
        return [
            event
            for event in events
            if not (event[1] == kind_of and _FROM_S <= event[2].stamp_s < _FROM_S + seconds)
        ]

    return fault


def _burst(_drive: PointDrive, events: list[Event]) -> list[Event]:
    """Poses of two seconds arrive at once."""
    changed = [
        (_FROM_S + 2.0 if kind == 1 and 0.0 <= arrival - _FROM_S < 2.0 else arrival, kind, sample)
        for arrival, kind, sample in events
    ]
    return sorted(changed, key=lambda event: event[:2])


def _clock(kind_of: int, step: float) -> Fault:
    """The stamps of one sensor jump; its samples arrive as before."""

    def fault(_drive: PointDrive, events: list[Event]) -> list[Event]:
        return [
            (arrival, kind, replace(s, stamp_s=s.stamp_s + step))
            if kind == kind_of and arrival >= _FROM_S
            else (arrival, kind, s)
            for arrival, kind, s in events
        ]

    return fault


FAULTS: dict[str, Fault] = {
    "none": lambda _drive, events: events,
    "wrong pose 10 m / 90 deg, 1 s": _wrong_for(1.0),
    "wrong pose 10 m / 90 deg, 10 s": _wrong_for(10.0),
    "wrong pose 10 m, moving alike, 10 s": _wrong_for(10.0, 0.0),
    "no poses for 5 s": _gap(1, 5.0),
    "no odometry for 1 s": _gap(0, 1.0),
    "2 s of poses at once": _burst,
    "odometry clock +1 s": _clock(0, 1.0),
    "odometry clock -1 s": _clock(0, -1.0),
    "pose clock +1 s": _clock(1, 1.0),
    "pose clock -1 s": _clock(1, -1.0),
}


def faults(
    seeds: int = 20, *, with_gnss: bool = True, only: str = ""
) -> dict[str, dict[str, float]]:
    """Each fault from second 10 on, through the whole localizer but for its particle filter.

    `recover_s` is the time after the fault's end (or begin, for a lasting one) until the error
    stays below 0.3 m; `jump_m` the largest step of a tick that the motion does not explain,
    outside flagged re-initializations.
    """
    table = {}
    for name, fault in FAULTS.items():
        if only not in name:
            continue
        rows = [_one_fault(seed, fault, name, with_gnss=with_gnss) for seed in range(seeds)]
        values = np.array([row[:5] for row in rows])
        table[name] = {
            "error_max_m": float(values[:, 0].max()),
            "error_max_median_m": float(np.median(values[:, 0])),
            "recover_s_max": float(values[:, 1].max()),
            "recover_s_median": float(np.median(values[:, 1])),
            "jump_m_max": float(values[:, 2].max()),
            "flagged_jump_m_max": float(values[:, 3].max()),
            "reinitialized": float((values[:, 4] > 0).sum()),
        }
    return table


_LASTS_S = {"10 s": 10.0, "1 s": 1.0, "5 s": 5.0, "once": 2.0}


def _one_fault(
    seed: int,
    fault: Fault,
    name: str,
    *,
    with_gnss: bool,
) -> tuple[float, ...]:
    drive = city_drive(seed, duration_s=28.0)
    events = events_of(drive)
    gnss = drive.drive.gnss
    if with_gnss and gnss is not None:
        fixes = [gnss.sample(row) for row in range(len(gnss))]
        events += [(fix.arrival_s, 2, fix) for fix in fixes]
        events.sort(key=lambda event: event[:2])
    stamps, poses, motion, flags, reinitialized = _localize(drive, fault(drive, events))
    true = drive.motion.at(stamps)
    error = np.hypot(*(poses[:, :2] - true[:, :2]).T)
    after = stamps >= _FROM_S
    lasting = name.startswith(("none", "odometry clock", "pose clock"))
    end = _FROM_S
    if not lasting:
        end += next(lasts for key, lasts in _LASTS_S.items() if name.endswith(f" {key}"))
    bad = stamps[after & (error > 0.3)]
    recover = max(0.0, float(bad.max()) - end) if len(bad) else 0.0
    plain = ~flags[1:]
    jump = _unexplained(stamps, poses, motion)
    flagged = jump[~plain & (stamps[1:] > 5.0)]
    return (
        float(error[after].max()),
        recover,
        float(jump[plain & (stamps[1:] > 5.0)].max()),
        float(flagged.max()) if len(flagged) else 0.0,
        float(reinitialized),
    )


def _unexplained(stamps: Floats, poses: Floats, motion: Floats) -> Floats:
    """How far each output is from where speed and yaw rate lead the one before."""
    dt = np.diff(stamps)
    expected = move_along_arc(poses[:-1], motion[1:, 0] * dt, motion[1:, 1] * dt)
    return np.asarray(np.hypot(*(poses[1:, :2] - expected[:, :2]).T))


def _localize(
    drive: PointDrive, events: list[Event]
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_], int]:
    """Through `Localizer`, clocks and all; poses are offered as healthy at their arrival."""
    config = LocalizeConfig()
    localizer = Localizer(None, config, 2.7, np.random.default_rng(0))
    stamps, poses, motion, flags, tick = [], [], [], [], 0
    for arrival, kind, sample in events:
        while tick / 100 < arrival:
            answer = localizer.pose_at(tick / 100)
            tick += 1
            if answer is not None:
                stamps.append(answer.stamp_s)
                poses.append(answer.pose)
                motion.append((answer.speed_mps, answer.yaw_rate_radps))
                flags.append(bool(answer.flag))
        if kind == 1:
            localizer.add_estimate(_estimate(sample, arrival))
        else:
            localizer.add_sample(replace(sample, arrival_s=arrival))
    count = localizer.summary().get("reinitializations", 0)
    return np.array(stamps), np.array(poses), np.array(motion), np.array(flags), count


def _estimate(pose: PointPose, arrival_s: float) -> PfEstimate:
    sd = float(math.sqrt(max(pose.covariance[0, 0], pose.covariance[1, 1])))
    health = HealthRecord(
        stamp_s=pose.stamp_s, matched=4, seen=4, in_view=4, n_eff=500.0, position_sd_major_m=sd,
        position_sd_minor_m=sd, exploration_ratio=0.0, lag_s=arrival_s - pose.stamp_s,
        particles=1000, match_share=1.0, modes=1, mode_share=1.0, evidence_share=1.0,
        yaw_rate_offset_radps=0.0, speed_scale=0.0,
    )  # fmt: skip
    return PfEstimate(pose.stamp_s, arrival_s, pose.pose, pose.covariance, True, 1, health, None)


if __name__ == "__main__":
    show("faults, 20 seeds, with GNSS", faults())
    show("wrong poses, 20 seeds, without GNSS", faults(with_gnss=False, only="wrong"))
