"""The figures of one replay, as metrics.json holds them, and their spread over many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, isfinite, nan, sqrt
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.landmark_kind import POINT_KINDS, LandmarkKind
from polemap.evaluation.errors import accuracy, first_on_poles_s
from polemap.localize.particle_filter.estimate import KindHealth
from polemap.localize.particle_filter.health import RestartCause
from polemap.localize.pose_queue import PoseUpdate
from polemap.localize.replay import Run
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import rotate_back
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]


def run_metrics(
    run: Run, drive: Drive, pole_map: PoleMap | CityMap | None = None
) -> dict[str, Any]:
    """Counts, latency, smoothness, accuracy where the drive has a reference, and timings.

    Args:
        run: a replay of the drive.
        drive: the drive, with its reference.
        pole_map: what it was localized in, for the landmarks that it holds.
    """
    counts = dict(run.counts)
    on_poles_s = first_on_poles_s(run.kf.stamp_s, run.output[:, 3]) if len(run.output) else None
    result: dict[str, Any] = {
        "drive": drive.name,
        "frame": str(drive.frame),
        "notes": list(drive.notes),
        "duration_s": float(drive.duration_s),
        "reinitializations": counts.pop("pf_reinitializations", 0),
        "reinitializations_by_cause": {
            cause: counts.pop(f"pf_reinitializations_{cause}", 0)
            for cause in get_args(RestartCause)
        },
        "exploration_events": counts.pop("pf_exploration_events", 0),
        "gate_rejections": counts.pop("gate_rejections", 0),
        "late_dropped": counts.pop("late_dropped", 0),
        "output_reinitializations": counts.pop("reinitializations", 0),
        "counts": counts,
        "input_problems": dict(drive.problems),
        "updates": len(run.updates),
        "output_poses": len(run.kf),
        "landmarks_by_kind": landmarks_by_kind(run.updates, counts, pole_map),
        "on_poles_from_s": on_poles_s,
        "latency_s": _latency(run.updates),
        "jump_max_m": float(run.output[:, 2].max()) if len(run.output) else 0.0,
        "flagged_ticks": sum(1 for flag in run.flags if flag),
        "smoothness": {
            "pf": smoothness(run.pf.stamp_s, run.pf.poses),
            "kf": smoothness(run.kf.stamp_s, run.kf.poses),
            "kf_at_pf_stamps": smoothness(*_sampled(run.kf, run.pf.stamp_s)),
        },
    }
    if drive.reference is not None and len(drive.reference):
        # the output counts from the first pole-based pose on; its start by GNSS stands apart
        start = run.kf.stamp_s < (-inf if on_poles_s is None else on_poles_s)
        parts = (("pf", run.pf), ("kf", run.kf.rows(~start)), ("kf_start", run.kf.rows(start)))
        for name, trajectory in parts:
            if len(trajectory):
                result[name] = accuracy(trajectory, drive.reference)
    if isfinite(run.replay_s):
        result["timing_ms"] = timing_summary(run.timings_s)
        result["replay_s"] = run.replay_s
    return result


def landmarks_by_kind(
    updates: Sequence[PoseUpdate],
    counts: Mapping[str, int],
    pole_map: PoleMap | CityMap | None = None,
) -> dict[str, dict[str, Any]]:
    """What the scans have shown of every kind of landmarks that the map holds.

    `in_map` (not known of a city's map), `seen`, `matched` (of lines: pieces), `suspensions`,
    `suspended_share` of the updates, and `residual_rms_m` from where the map has those that match,
    across lines.
    """
    rows: dict[int, list[KindHealth]] = {}
    for update in updates:
        for one in update.estimate.health.by_kind:
            rows.setdefault(one.kind, []).append(one)
    result: dict[str, dict[str, Any]] = {}
    for kind, found in sorted(rows.items()):
        name = LandmarkKind(kind).name.lower()
        matched = sum(one.matched for one in found)
        squared_m2 = sum(one.squared_m2 for one in found)
        counted = "corners_suspended" if kind in POINT_KINDS else f"lines_suspended_{name}"
        held = (
            {}
            if pole_map is None or isinstance(pole_map, CityMap)
            else {"in_map": _mapped(pole_map, kind)}
        )
        result[name] = {
            **held,
            "seen": sum(one.seen for one in found),
            "matched": matched,
            "suspensions": 0 if kind == LandmarkKind.POLE else counts.get(f"pf_{counted}", 0),
            "suspended_share": sum(one.suspended for one in found) / max(len(updates), 1),
            "residual_rms_m": sqrt(squared_m2 / matched) if matched else nan,
        }
    return result


def _mapped(pole_map: PoleMap, kind: int) -> int:
    lines = pole_map.lines
    kinds = pole_map.kind if kind in POINT_KINDS or lines is None else lines.kind
    return int(np.count_nonzero(kinds == kind))


def smoothness(stamps_s: Floats, poses: Floats) -> dict[str, float]:
    """How smooth a trajectory is: rms of its third difference per axis of the vehicle.

    Given as it stands (metres between neighbours) and as jerk, divided by the step cubed.
    """
    if len(poses) < 4:
        return {}
    step = float(np.median(np.diff(stamps_s)))
    even = np.abs(np.diff(stamps_s) - step) < 0.1 * step
    third = np.diff(poses[:, :2], n=3, axis=0)
    whole = even[:-2] & even[1:-1] & even[2:]
    heading = poses[1:-2, 2]
    along, lateral = rotate_back(third, heading).T
    if not whole.any():
        return {}
    return {
        "lateral_third_difference_m": _rms(lateral[whole]),
        "longitudinal_third_difference_m": _rms(along[whole]),
        "lateral_jerk_rms_mps3": _rms(lateral[whole]) / step**3,
    }


def timing_summary(timings_s: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float]]:
    """Median, p95 and p99 in milliseconds per stage, with the number of calls."""
    return {
        stage: {
            "median": float(np.median(values)) * 1e3,
            "p95": float(np.percentile(values, 95)) * 1e3,
            "p99": float(np.percentile(values, 99)) * 1e3,
            "calls": len(values),
        }
        for stage, values in timings_s.items()
        if len(values)
    }


def spread(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean, standard deviation, least and most of every number that the runs share, as a tree.

    Numbers that are not finite are left out of their statistics; text and lists are not averaged.
    """
    result: dict[str, Any] = {}
    for key in runs[0] if runs else ():
        values = [run[key] for run in runs if key in run]
        if all(isinstance(value, Mapping) for value in values):
            result[key] = spread(values)
        elif all(
            isinstance(value, int | float) and not isinstance(value, bool) for value in values
        ):
            finite = np.array([value for value in values if isfinite(value)])
            if len(finite):
                sd = float(finite.std(ddof=1)) if len(finite) > 1 else 0.0
                result[key] = {
                    "mean": float(finite.mean()),
                    "sd": sd,
                    "min": float(finite.min()),
                    "max": float(finite.max()),
                    "runs": len(finite),
                }
    return result


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _sampled(kf: Trajectory, stamps_s: Floats) -> tuple[Floats, Floats]:
    """The output between its ticks, so that equal steps are compared."""
    if not len(kf):
        return np.empty(0), np.empty((0, 3))
    inside = stamps_s[(stamps_s >= kf.stamp_s[0]) & (stamps_s <= kf.stamp_s[-1])]
    columns = (kf.poses[:, 0], kf.poses[:, 1], np.unwrap(kf.poses[:, 2]))
    return inside, np.stack([np.interp(inside, kf.stamp_s, c) for c in columns], axis=1)


def _latency(updates: Sequence[PoseUpdate]) -> Mapping[str, float]:
    late = np.array([u.taken_s - u.estimate.stamp_s for u in updates])
    if not len(late):
        return {}
    return {"median": float(np.median(late)), "p95": float(np.percentile(late, 95))}
