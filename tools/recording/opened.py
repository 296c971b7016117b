"""A run folder with the map and the drive that belong to it, opened to be shown or converted."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.readers.registry import open_drive
from polemap.evaluation.runs.io import Run, RunSet, read_run_set
from polemap.map.city.city_map import along
from polemap.map.city.io import open_map
from polemap.map.pole_map import PoleMap
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats | Sequence[str]]

# of a city the poles that a picture of the way shows
_POLES_AROUND_M = 200.0

# columns of output.csv and health.csv that go with each pose
_OF_OUTPUT = (
    "speed_mps", "yaw_rate_radps", "var_east_m2", "var_north_m2", "cov_east_north_m2",
    "var_yaw_rad2", "pose_age_s", "flag", "healthy", "distrust",
)  # fmt: skip
_OF_HEALTH = ("matched", "seen", "in_view", "n_eff", "position_sd_major_m", "gate", "healthy")


@dataclass(frozen=True, slots=True)
class OpenedRun:
    """One run and what it was made from, as far as that is still there.

    Attributes:
        drive: only where it was asked for; its lap where the run is one of a lap.
        notes: what is missing, and how to give it.
        config: content of config.yaml.
    """

    name: str
    run: Run
    frame: EarthFrame
    pole_map: PoleMap | None
    drive: Drive | None
    notes: tuple[str, ...]
    config: Mapping[str, Any]
    lap: str | None
    topics: Path | None = None

    def trajectory(self, which: str) -> tuple[Trajectory, Columns]:
        """`kf`, the 100 Hz output, or `pf`, the particle filter, and what is known of each pose."""
        if which == "kf":
            return self.run.kf, _aligned(self.run.kf, self.run.output_table(), _OF_OUTPUT)
        return self.run.pf, _aligned(self.run.pf, self.run.health, _OF_HEALTH)


def open_run(
    path: Path,
    number: int = 0,
    map_file: Path | None = None,
    drive: Path | None = None,
    topics: Path | None = None,
) -> OpenedRun:
    """A run folder of `polemap localize`, or run `number` of one with several.

    Args:
        map_file: in place of the one that the run names.
        drive: the drive that was localized, for its pictures.
        topics: mapping of its topics, in place of the one that the run names.

    Raises:
        InputError: the folder, its map or its drive cannot be read, or its frame is not known.
        ConfigError: it has no run of that number.
    """
    runs = read_run_set(path, allow_without_poles=True)
    if not 0 <= number < len(runs.runs):
        raise ConfigError(f"{path}: has runs 0 to {len(runs.runs) - 1}; there is no run {number}")
    opened = None
    if drive is not None:
        topics = topics or _topics_of(runs, drive)
        opened = open_drive(drive, topics=topics)
        opened = opened if runs.lap is None else opened.lap(runs.lap)
    frame = opened.frame if opened is not None else _frame_of(runs)
    pole_map, notes = _map_of(runs, map_file, frame, runs.runs[number].kf.poses[:, :2])
    frame = frame or (pole_map.frame if pole_map is not None else None)
    if frame is None:
        raise InputError(
            f"{path}: neither the run nor its map says in which earth frame it is; give --map MAP "
            "or --drive DRIVE"
        )
    name = runs.name if len(runs.runs) == 1 else f"{runs.name}/{number:03d}"
    chosen = runs.runs[number]
    return OpenedRun(name, chosen, frame, pole_map, opened, notes, runs.config, runs.lap, topics)


def _topics_of(runs: RunSet, drive: Path) -> Path | None:
    """The run's mapping of topics, for the drive that it names and not for a copy in a folder."""
    if runs.drive is None or os.path.realpath(runs.drive) != os.path.realpath(drive):
        return None
    return runs.topics


def _frame_of(runs: RunSet) -> EarthFrame | None:
    """What the run says; runs of an earlier polemap say nothing, their drive may."""
    stated = runs.config.get("frame")
    if stated is not None:
        return EarthFrame.from_dict(stated)
    drive = runs.drive
    if drive is None or not os.path.exists(drive):
        return None
    return open_drive(drive, topics=runs.topics).frame


def _map_of(
    runs: RunSet, map_file: Path | None, frame: EarthFrame | None, path_m: Floats
) -> tuple[PoleMap | None, tuple[str, ...]]:
    place = map_file or runs.map
    if place is None:
        return None, ()
    if map_file is None and not os.path.exists(place):
        return None, (f"the run's map {place} is gone: no poles are shown; --map MAP gives it",)
    return along(open_map(place, frame), path_m, _POLES_AROUND_M), ()


def _aligned(
    trajectory: Trajectory, table: Mapping[str, Floats | list[str]] | None, names: Sequence[str]
) -> Columns:
    """Columns of a table at the stamps of the poses; none where a stamp has no row."""
    stamps = None if table is None else table.get("stamp_s")
    if table is None or not isinstance(stamps, np.ndarray) or not len(stamps):
        return {}
    row = np.clip(np.searchsorted(stamps, trajectory.stamp_s), 0, len(stamps) - 1)
    if not np.array_equal(stamps[row], trajectory.stamp_s):
        return {}
    return {
        name: column[row] if isinstance(column, np.ndarray) else [column[one] for one in row]
        for name in names
        if (column := table.get(name)) is not None
    }
