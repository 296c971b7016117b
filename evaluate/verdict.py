"""Whether a run may be trusted, from the run itself: most drives have no reference."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.evaluation.fix_offset import fix_offset
from polemap.localize.config import GnssConfig
from polemap.localize.replay import Run
from polemap.map.city.city_map import CityMap, along
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

# shares of the output, and of the scans, that were healthy: below the first a run is not to be
# trusted, below the second only in part
HEALTHY_NOT, HEALTHY_PARTLY = 0.5, 0.9
# stretch without a matched pole after which the pose is dead reckoning
WITHOUT_POLES_S = 15.0
# stated standard deviation of the position beyond which the lane is not known
STATED_SD_M = 0.5
# cheap fixes are some metres off, in streets some ten
FIXES_PARTLY_M, FIXES_NOT_M = 12.0, 30.0
_HISTORY = "history"
# of a city the poles around so many places of a run tell whether it was built from the drive
_PLACES, _AROUND_M = 20, 50.0


def judge(
    run: Run,
    drive: Drive,
    pole_map: PoleMap | CityMap | None,
    gnss: GnssConfig | None = None,
) -> dict[str, Any]:
    """The verdict of a run: its grounds as numbers, `trust` and one `sentence`.

    `trust` is `trustworthy`, `partly` or `not`. NaN stands for what the drive does not show.
    """
    scans = np.array([update.estimate.healthy for update in run.updates], dtype=bool)
    matched = np.array([update.estimate.health.matched for update in run.updates], dtype=float)
    stamps = np.array([update.estimate.stamp_s for update in run.updates])
    order = np.argsort(stamps, kind="stable")
    matched, stamps = matched[order], stamps[order]
    trusted = np.array([not reason for reason in run.distrust], dtype=bool)
    grounds = {
        "healthy_share": float(trusted.mean()) if len(trusted) else 0.0,
        "healthy_scans_share": float(scans.mean()) if len(scans) else 0.0,
        "matched_poles_mean": float(matched.mean()) if len(matched) else 0.0,
        "position_sd_m": _stated(run),
        "longest_without_poles_s": _without_poles(stamps, matched, drive),
        "fixes_to_pose_m": _fixes(run, drive),
    }
    own = False
    if pole_map is not None:
        places = run.kf.poses[:: max(1, len(run.kf) // _PLACES), :2]
        own = built_from(along(pole_map, places, _AROUND_M, (_HISTORY,)), drive)
    offset = fix_offset(run, drive, gnss or GnssConfig()) if pole_map is not None else None
    grounds["fixes_offset_m"] = offset.distance_m if offset else float("nan")
    grounds["fixes_offset_sd_m"] = offset.sd_m if offset else float("nan")
    trust, reasons = _weigh(
        grounds, with_map=pole_map is not None, aside=offset.finding if offset else ""
    )
    if own:
        reasons = [*reasons, "the map was built from this drive: the figures flatter"]
    return {
        "trust": trust,
        "sentence": f"{_WORDS[trust]}: {'; '.join(reasons)}",
        **grounds,
        "map_built_from_this_drive": own,
    }


_WORDS = {
    "trustworthy": "trustworthy",
    "partly": "partly trustworthy",
    "not": "not trustworthy",
}


def verdict_lines(verdict: dict[str, Any]) -> list[str]:
    """The verdict as `localize` ends with it."""
    facts = [
        f"{100 * _mean(verdict, 'healthy_share'):.0f} % of the drive healthy",
        f"{_mean(verdict, 'matched_poles_mean'):.1f} poles matched a scan",
        f"at most {_mean(verdict, 'longest_without_poles_s'):.1f} s without a matched pole",
    ]
    if np.isfinite(stated := _mean(verdict, "position_sd_m")):
        facts.insert(2, f"stated deviation {stated:.2f} m")
    if np.isfinite(fixes := _mean(verdict, "fixes_to_pose_m")):
        facts.append(f"fixes {fixes:.1f} m from the pose")
    return [f"verdict: {verdict['sentence']}", f"         {', '.join(facts)}"]


def _mean(verdict: dict[str, Any], name: str) -> float:
    """A ground of one run, or its mean over many; NaN where there is none."""
    value = verdict.get(name)
    if isinstance(value, dict):
        value = value.get("mean")
    return float("nan") if value is None else float(value)


def built_from(pole_map: PoleMap, drive: Drive) -> bool:
    """Whether the map's history names this drive, or the whole of which it is a part."""
    texts = pole_map.extra.get(_HISTORY)
    if texts is None or not len(pole_map):
        return False
    start, end = drive.span_s
    name = drive.name.split(":", 1)
    for entry in set(_ENTRY.findall("".join(str(text) for text in texts))):
        of, since = json.loads(entry[0]).split(":", 1), float(entry[1])
        # laps of one drive are different drives; the whole holds its laps
        same = of == name or (of[0] == name[0] and 1 in (len(of), len(name)))
        if same and (start - 1.0 <= since <= end or (len(of) == 1 and since <= start)):
            return True
    return False


_ENTRY = re.compile(r'"drive":("(?:[^"\\]|\\.)*"),"start_s":([-+.0-9eE]+)')


def _weigh(grounds: dict[str, float], *, with_map: bool, aside: str = "") -> tuple[str, list[str]]:
    """What the grounds say, and the reasons that decide."""
    bad: list[str] = []
    doubtful: list[str] = []
    share, fixes = grounds["healthy_share"], grounds["fixes_to_pose_m"]
    if with_map:
        scans = grounds["healthy_scans_share"]
        if scans < HEALTHY_PARTLY:
            text = f"{100 * scans:.0f} % of the scans gave a healthy pose"
            (bad if scans < HEALTHY_NOT else doubtful).append(text)
        if share < HEALTHY_PARTLY:
            text = f"{100 * share:.0f} % of the output was healthy"
            (bad if share < HEALTHY_NOT else doubtful).append(text)
        if grounds["longest_without_poles_s"] > WITHOUT_POLES_S:
            gap = grounds["longest_without_poles_s"]
            doubtful.append(f"{gap:.0f} s without a matched pole")
    else:
        doubtful.append("odometry and fixes alone know the lane nowhere")
    if np.isfinite(fixes) and fixes > FIXES_PARTLY_M:
        (bad if fixes > FIXES_NOT_M else doubtful).append(f"fixes {fixes:.0f} m from the pose")
    if aside:
        doubtful.append(aside)
    if grounds["position_sd_m"] > STATED_SD_M:
        doubtful.append(f"the stated deviation is {grounds['position_sd_m']:.2f} m")
    if bad:
        return "not", bad + doubtful
    if doubtful:
        return "partly", doubtful
    return "trustworthy", ["healthy nearly throughout, poles and fixes agree"
                           if np.isfinite(fixes) else "healthy nearly throughout"]  # fmt: skip


def _stated(run: Run) -> float:
    """Median of the larger standard deviation of the output's position, from its first pole on."""
    covariance = run.kf.covariance
    if covariance is None or not len(run.kf):
        return float("nan")
    held = np.isfinite(run.output[:, 3]) if len(run.output) else np.zeros(0, dtype=bool)
    blocks = covariance[held][:, :2, :2] if held.any() else covariance[:, :2, :2]
    middle = 0.5 * (blocks[:, 0, 0] + blocks[:, 1, 1])
    spread = np.hypot(0.5 * (blocks[:, 0, 0] - blocks[:, 1, 1]), blocks[:, 0, 1])
    return float(np.sqrt(np.median(middle + spread)))


def _without_poles(stamps: Floats, matched: Floats, drive: Drive) -> float:
    """Longest time between matched poles, the drive's start and end included."""
    odometry = drive.odometry
    start, end = drive.span_s
    if odometry is not None and len(odometry):
        start, end = float(odometry.stamp_s[0]), float(odometry.stamp_s[-1])
    marks = np.concatenate([[start], stamps[matched > 0], [end]])
    return float(np.diff(np.sort(marks)).max())


def _fixes(run: Run, drive: Drive) -> float:
    """Median distance of the fixes to the antenna of the output's pose; NaN without either."""
    gnss = drive.gnss
    if gnss is None or not len(gnss) or len(run.kf) < 2:
        return float("nan")
    inside = (gnss.stamp_s >= run.kf.stamp_s[0]) & (gnss.stamp_s <= run.kf.stamp_s[-1])
    if not inside.any():
        return float("nan")
    nearest = np.searchsorted(run.kf.stamp_s, gnss.stamp_s[inside])
    poses = run.kf.poses[np.clip(nearest, 0, len(run.kf) - 1)]
    yaw = wrap_angle(poses[:, 2])
    ahead, left = drive.gnss_antenna_m
    east = poses[:, 0] + ahead * np.cos(yaw) - left * np.sin(yaw)
    north = poses[:, 1] + ahead * np.sin(yaw) + left * np.cos(yaw)
    return float(np.median(np.hypot(gnss.east_m[inside] - east, gnss.north_m[inside] - north)))
