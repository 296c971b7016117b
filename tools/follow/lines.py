"""Answers as JSON, one object a line."""

from __future__ import annotations

import json
from math import isfinite
from typing import Any

import numpy as np

from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.tools.follow.engine import Tick


def tick_values(tick: Tick, frame: EarthFrame) -> dict[str, Any]:
    """What a line says; see docs/live.md."""
    answer = tick.answer
    east, north, yaw = answer.pose
    middle = 0.5 * (answer.covariance[0, 0] + answer.covariance[1, 1])
    spread = np.hypot(
        0.5 * (answer.covariance[0, 0] - answer.covariance[1, 1]), answer.covariance[0, 1]
    )
    values: dict[str, Any] = {
        "stamp_s": round(answer.stamp_s, 6),
        "east_m": round(east, 4),
        "north_m": round(north, 4),
        "yaw_rad": round(yaw, 6),
        "speed_mps": round(answer.speed_mps, 4),
        "yaw_rate_radps": round(answer.yaw_rate_radps, 6),
        "position_sd_m": round(float(np.sqrt(middle + spread)), 4),
        "yaw_sd_rad": round(float(np.sqrt(answer.covariance[2, 2])), 6),
        "healthy": answer.healthy,
        "distrust": answer.distrust,
        "flag": answer.flag,
        "pose_age_s": round(answer.pose_age_s, 3) if isfinite(answer.pose_age_s) else None,
        "lag_s": round(tick.lag_s, 4),
        "frames_skipped": tick.frames_skipped,
    }
    if frame.is_utm:
        latitude, longitude = geographic_from_grid(frame, np.array([[east, north]]))[0]
        values["latitude_deg"] = round(float(latitude), 9)
        values["longitude_deg"] = round(float(longitude), 9)
    return values


def tick_line(tick: Tick, frame: EarthFrame) -> str:
    """`tick_values` as JSON with its line end."""
    return json.dumps(tick_values(tick, frame), allow_nan=False) + "\n"
