"""Run folders on the disk: trajectories, health, metrics, settings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.tum import shortest, write_tum
from polemap.localize.particle_filter.estimate import HealthRecord, KindHealth, LineHealth
from polemap.localize.replay import Run
from polemap.parsing.json_text import plain_values

Floats = NDArray[np.float64]

HEALTH_COLUMNS = (
    "stamp_s", "matched", "seen", "in_view", "n_eff", "position_sd_major_m",
    "position_sd_minor_m", "exploration_ratio", "gate", "lag_s", "particles", "modes",
    "match_share", "healthy", "event", "yaw_sd_rad", "yaw_rate_offset_radps", "speed_scale",
    "nis",
)  # fmt: skip
# of runs in a map that holds lines
LINE_COLUMNS = ("lines_matched", "lines_seen", "lines_suspended")
# of runs in a map that holds corners, which `matched` and `seen` count, too
CORNER_COLUMNS = ("corners_matched", "corners_seen", "corners_suspended")
OUTPUT_COLUMNS = (
    "stamp_s", "speed_mps", "yaw_rate_radps", "var_east_m2", "var_north_m2", "cov_east_north_m2",
    "var_yaw_rad2", "pose_age_s", "jump_m", "flag", "healthy", "distrust", "east_m", "north_m",
    "yaw_rad",
)  # fmt: skip


def write_run(
    folder: Path,
    run: Run,
    metrics: Mapping[str, Any],
    config: Mapping[str, Any],
    perception_s: Mapping[str, Mapping[float, float]] | None = None,
) -> None:
    """Write the files of a run into a folder that exists, and timing.csv of a timed run.

    Args:
        metrics: content of metrics.json.
        config: content of config.yaml, every setting as used.
        perception_s: seconds that each stage before the particle filter took, by the scan's stamp.
    """
    write_tum(folder / "pf.tum", run.pf)
    write_tum(folder / "kf.tum", run.kf)
    _write_health(folder / "health.csv", run)
    _write_output(folder / "output.csv", run)
    write_config(folder / "config.yaml", config)
    write_metrics(folder / "metrics.json", metrics)
    if any(isfinite(update.update_s) for update in run.updates):
        _write_timing(folder / "timing.csv", run, perception_s or {})


def write_config(path: Path, config: Mapping[str, Any]) -> None:
    """Write the settings of a run as YAML."""
    with atomic_file(path) as part:
        part.write_text(yaml.safe_dump(dict(config), sort_keys=False), encoding="utf-8")


def write_metrics(path: Path, metrics: Mapping[str, Any]) -> None:
    """JSON; numbers that are not finite become null."""
    with atomic_file(path) as part:
        text = json.dumps(plain_values(metrics), indent=2, allow_nan=False)
        part.write_text(text + "\n", encoding="utf-8")


def _write_health(path: Path, run: Run) -> None:
    with atomic_file(path) as part, part.open("w", encoding="utf-8") as file:
        with_lines = any(update.estimate.health.lines is not None for update in run.updates)
        with_corners = any(_of_corners(update.estimate.health) for update in run.updates)
        columns = (*HEALTH_COLUMNS, *(LINE_COLUMNS if with_lines else ()))
        columns = (*columns, *(CORNER_COLUMNS if with_corners else ()))
        file.write(",".join(columns) + "\n")
        for update in sorted(run.updates, key=lambda update: update.estimate.stamp_s):
            estimate, health = update.estimate, update.estimate.health
            row: tuple[Any, ...] = (
                health.stamp_s, health.matched, health.seen, health.in_view, health.n_eff,
                health.position_sd_major_m, health.position_sd_minor_m, health.exploration_ratio,
                update.decision, update.taken_s - health.stamp_s, health.particles,
                health.modes, health.match_share, int(estimate.healthy), estimate.event or "",
                float(np.sqrt(estimate.covariance[2, 2])), health.yaw_rate_offset_radps,
                health.speed_scale, update.nis if isfinite(update.nis) else "",
            )  # fmt: skip
            if with_lines:
                lines = health.lines or LineHealth()
                row = (*row, lines.matched, lines.seen, " ".join(lines.suspended))
            if with_corners:
                found = _of_corners(health)
                corners = (found.matched, found.seen, found.suspended) if found else (0, 0, False)
                row = (*row, *map(int, corners))
            file.write(",".join(map(_cell, row)) + "\n")


def _of_corners(health: HealthRecord) -> KindHealth | None:
    return next((one for one in health.by_kind if one.kind == LandmarkKind.CORNER), None)


def _write_timing(path: Path, run: Run, perception_s: Mapping[str, Mapping[float, float]]) -> None:
    """Milliseconds of every stage at every update; an empty cell is a stage that did not run."""
    names = [*perception_s, "particle_filter", "output_pose"]
    with atomic_file(path) as part, part.open("w", encoding="utf-8") as file:
        file.write(",".join(["stamp_s", *(f"{name}_ms" for name in names)]) + "\n")
        for update in sorted(run.updates, key=lambda update: update.estimate.stamp_s):
            stamp_s = update.estimate.stamp_s
            spent = [*(stage.get(stamp_s, nan) for stage in perception_s.values())]
            spent += [update.update_s, update.offer_s]
            cells = [f"{1e3 * value:.4f}" if isfinite(value) else "" for value in spent]
            file.write(",".join([shortest(stamp_s), *cells]) + "\n")


def _write_output(path: Path, run: Run) -> None:
    p, out = run.kf.covariance, run.output
    if p is None:
        raise ValueError("a run states the covariance of its output")
    table = np.column_stack(
        [run.kf.stamp_s, out[:, 0], out[:, 1], p[:, 0, 0], p[:, 1, 1], p[:, 0, 1], p[:, 2, 2],
         out[:, 3], out[:, 2]]
    )  # fmt: skip
    with atomic_file(path) as part, part.open("w", encoding="utf-8") as file:
        file.write(",".join(OUTPUT_COLUMNS) + "\n")
        for row, flag, reason, pose in zip(
            table.tolist(), run.flags, run.distrust, run.kf.poses.tolist(), strict=True
        ):
            cells = (*row, flag, int(not reason), reason, *pose)
            file.write(",".join(map(_cell, cells)) + "\n")


def _cell(value: Any) -> str:
    return shortest(value) if isinstance(value, float) else str(value)
