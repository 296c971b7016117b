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
from polemap.drivelog.errors import InputError
from polemap.localize.replay import Run, Trajectory

Floats = NDArray[np.float64]

HEALTH_COLUMNS = (
    "stamp_s", "matched", "seen", "in_view", "n_eff", "position_sd_major_m",
    "position_sd_minor_m", "exploration_ratio", "gate", "lag_s", "particles", "modes",
    "match_share", "healthy", "event", "yaw_sd_rad", "yaw_rate_offset_radps", "speed_scale",
    "nis",
)  # fmt: skip
OUTPUT_COLUMNS = (
    "stamp_s", "speed_mps", "yaw_rate_radps", "var_east_m2", "var_north_m2", "cov_east_north_m2",
    "var_yaw_rad2", "pose_age_s", "jump_m", "flag",
)  # fmt: skip


def write_run(
    folder: Path,
    run: Run,
    config: Mapping[str, Any],
    looked_s: Mapping[str, Mapping[float, float]] | None = None,
) -> None:
    """Write the files of a run into a folder that exists, and timing.csv of a timed run.

    Args:
        looked_s: seconds that each stage before the particle filter took, by the scan's stamp.
    """
    write_tum(folder / "pf.tum", run.pf)
    write_tum(folder / "kf.tum", run.kf)
    _write_health(folder / "health.csv", run)
    _write_output(folder / "output.csv", run)
    write_config(folder / "config.yaml", config)
    write_metrics(folder / "metrics.json", run.metrics)
    if any(isfinite(update.update_s) for update in run.updates):
        _write_timing(folder / "timing.csv", run, looked_s or {})


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """`stamp x y z qx qy qz qw` per line; z, qx and qy are 0 in the plane."""
    half = 0.5 * trajectory.poses[:, 2]
    table = np.zeros((len(half), 8))
    table[:, 0] = trajectory.stamps_s
    table[:, 1:3] = trajectory.poses[:, :2]
    table[:, 6], table[:, 7] = np.sin(half), np.cos(half)
    with atomic_file(path) as part, part.open("w", encoding="utf-8") as file:
        # repr is the shortest text that reads back to the same double
        file.writelines(" ".join(map(_number, row)) + "\n" for row in table.tolist())


def read_tum(path: Path) -> tuple[Floats, Floats]:
    """Stamps `(n,)` and poses `(n, 3)` (east, north, yaw) of a TUM trajectory.

    Raises:
        InputError: no such file, or a line that does not hold eight numbers.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a TUM trajectory ({error})") from error
    rows = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError as error:
            raise InputError(f"{path}:{number}: {error}") from error
        if len(row) != 8 or not np.isfinite(row).all():
            raise InputError(
                f"{path}:{number}: expected 'stamp x y z qx qy qz qw', eight finite numbers"
            )
        rows.append(row)
    table = np.array(rows).reshape(-1, 8)
    qx, qy, qz, qw = table[:, 4], table[:, 5], table[:, 6], table[:, 7]
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    return table[:, 0], np.column_stack([table[:, 1:3], yaw])


def write_config(path: Path, config: Mapping[str, Any]) -> None:
    with atomic_file(path) as part:
        part.write_text(yaml.safe_dump(dict(config), sort_keys=False), encoding="utf-8")


def write_metrics(path: Path, metrics: Mapping[str, Any]) -> None:
    """JSON; numbers that are not finite become null."""
    with atomic_file(path) as part:
        text = json.dumps(_finite(metrics), indent=2, allow_nan=False)
        part.write_text(text + "\n", encoding="utf-8")


def _write_health(path: Path, run: Run) -> None:
    with atomic_file(path) as part, part.open("w", encoding="utf-8") as file:
        file.write(",".join(HEALTH_COLUMNS) + "\n")
        for update in sorted(run.updates, key=lambda update: update.estimate.stamp_s):
            estimate, health = update.estimate, update.estimate.health
            row = (
                health.stamp_s, health.matched, health.seen, health.in_view, health.n_eff,
                health.position_sd_major_m, health.position_sd_minor_m, health.exploration_ratio,
                update.decision, update.taken_s - health.stamp_s, health.particles,
                health.modes, health.match_share, int(estimate.healthy), estimate.event or "",
                float(np.sqrt(estimate.covariance[2, 2])), health.yaw_rate_offset_radps,
                health.speed_scale, update.nis if isfinite(update.nis) else "",
            )  # fmt: skip
            file.write(",".join(map(_number, row)) + "\n")


def _write_timing(path: Path, run: Run, looked_s: Mapping[str, Mapping[float, float]]) -> None:
    """Milliseconds of every stage at every update; an empty cell is a stage that did not run."""
    names = [*looked_s, "particle_filter", "output_pose"]
    with atomic_file(path) as part, part.open("w", encoding="utf-8") as file:
        file.write(",".join(["stamp_s", *(f"{name}_ms" for name in names)]) + "\n")
        for update in sorted(run.updates, key=lambda update: update.estimate.stamp_s):
            stamp_s = update.estimate.stamp_s
            spent = [*(stage.get(stamp_s, nan) for stage in looked_s.values())]
            spent += [update.update_s, update.offer_s]
            cells = [f"{1e3 * value:.4f}" if isfinite(value) else "" for value in spent]
            file.write(",".join([_number(stamp_s), *cells]) + "\n")


def _write_output(path: Path, run: Run) -> None:
    p, out = run.kf.covariance, run.output
    table = np.column_stack(
        [run.kf.stamps_s, out[:, 0], out[:, 1], p[:, 0, 0], p[:, 1, 1], p[:, 0, 1], p[:, 2, 2],
         out[:, 3], out[:, 2]]
    )  # fmt: skip
    with atomic_file(path) as part, part.open("w", encoding="utf-8") as file:
        file.write(",".join(OUTPUT_COLUMNS) + "\n")
        for row, flag in zip(table.tolist(), run.flags, strict=True):
            file.write(",".join(map(_number, row)) + f",{flag}\n")


def _number(value: Any) -> str:
    if isinstance(value, float):
        return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return str(value)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
