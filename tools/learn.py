"""`polemap localize --learn`: what a drive saw, in a copy of the map that it was localized in."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.build.build_map import build_map
from polemap.build.slam.slam import SlamResult, solve_in_map
from polemap.drivelog.atomic import check_files
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError, InputError
from polemap.extras import check_installed
from polemap.map.io import check_writable, read_map, write_map
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings
from polemap.tools.map_slam import motion_noise
from polemap.tools.progress import progress
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

_ABSOLUTE = ("absolute_var_east_m2", "absolute_var_north_m2", "absolute_cov_east_north_m2")


def check_learn(out: Path, map_file: Path | None, runs: int, inputs: Sequence[Path | None]) -> None:
    """Refuse what cannot be learnt before the drive is localized.

    Raises:
        ConfigError: no map, several runs, or a map to write over the one that is read.
        InputError: a map of tiles, or a name that no format has.
        MissingExtraError: gtsam is not installed.
    """
    if map_file is None:
        raise ConfigError("--learn adds to a map: give --map MAP")
    if runs > 1:
        raise ConfigError("--learn takes one run: drop --runs")
    if map_file.is_dir():
        raise InputError(
            f"{map_file}: a map of tiles is brought up to date by 'polemap map --update'; --learn "
            "adds to a map of one file"
        )
    if os.path.realpath(out) == os.path.realpath(map_file):
        raise ConfigError(f"--learn {out}: that is the map itself; name a copy of it")
    check_files([out], inputs)
    check_writable(out)
    check_installed("gtsam")


def learn(
    drive: Drive,
    scans: Sequence[Detections],
    found: Trajectory,
    map_file: Path,
    out: Path,
    settings: Settings,
) -> tuple[str, ...]:
    """Solve for the way of a localized drive, add what it saw, and write the map; what to say.

    Raises:
        InputError: see `solve_in_map`.
        FrameError: the map lies in another frame.
    """
    old = read_map(map_file, drive.frame)
    with progress(None, "solving poses and poles"):
        solved = solve_in_map(
            drive.name, drive, scans, found, old, settings.polemap.mapping,
            settings.polemap.slam, motion_noise(settings.localize),
        )  # fmt: skip
        placed = replace(drive, reference=solved.references[0])
        built = build_map([placed], settings.polemap, lambda _drive: scans, update=old)
    added = ~np.isin(built.pole_map.ids, old.ids)
    learnt = _with_precision(built.pole_map, old, solved, added)
    write_map(learnt, out)
    return (*built.reports, *_said(learnt, added, out))


def _with_precision(
    learnt: PoleMap, old: PoleMap, solved: SlamResult, added: NDArray[np.bool_]
) -> PoleMap:
    """Poles that were added with what the graph knows of them; the others keep what they had."""
    learnt = solved.with_precision(learnt, added)
    order = np.argsort(old.ids)
    row = order[np.searchsorted(old.ids, learnt.ids[~added], sorter=order)]
    extra = dict(learnt.extra)
    for name in _ABSOLUTE:
        values = np.array(extra[name], dtype=np.float64)
        before = np.asarray(old.extra.get(name, np.full(len(old), np.nan)), dtype=np.float64)
        values[~added] = before[row]
        # the graph holds the map for true: what the map is off by comes on top
        known = before[np.isfinite(before)]
        if len(known):
            values[added] += np.median(known)
        extra[name] = values
    return replace(learnt, extra=extra)


def _said(learnt: PoleMap, added: NDArray[np.bool_], out: Path) -> tuple[str, ...]:
    count = int(np.count_nonzero(added))
    line = f"{out}: {len(learnt)} poles, {count} of them new"
    if count:
        east, north = (np.asarray(learnt.extra[name])[added] for name in _ABSOLUTE[:2])
        sd = np.sqrt(0.5 * (east + north))
        known = sd[np.isfinite(sd)]
        if len(known):
            line += (
                f", known in the map to {np.median(known):.2f} m an axis (median, the worst "
                f"{known.max():.2f} m)"
            )
    waiting = learnt.doubtful
    if waiting is not None and len(waiting):
        line += f"; {len(waiting)} seen too seldom, or where earlier drives saw none, wait for more"
    return (line,)
