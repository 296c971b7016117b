"""Run folders as `polemap localize` writes them: one run, or a Monte Carlo set of them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.tum import read_tum
from polemap.evaluation.errors import first_on_poles_s
from polemap.evaluation.runs.damage import check_metrics, check_table
from polemap.parsing.csv_text import read_rows
from polemap.parsing.errors import named
from polemap.parsing.json_text import read_json
from polemap.parsing.yaml_text import read_yaml
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Run:
    """One localized replay.

    Attributes:
        health: columns of health.csv; numbers as arrays, the rest as lists of text.
        timings: columns of timing.csv (milliseconds per update) where the run kept them.
        metrics: content of metrics.json.
    """

    seed: int
    pf: Trajectory
    kf: Trajectory
    health: Mapping[str, Floats | list[str]]
    timings: Mapping[str, Floats]
    metrics: Mapping[str, Any]
    folder: Path | None = None

    def output_covariance(self) -> tuple[Floats, Floats] | None:
        """Stamps `(n,)` and covariances `(n, 3, 3)` of the output filter, where the run kept them.

        Raises:
            InputError: output.csv is there but damaged.
        """
        table = self.output_table()
        if table is None:
            return None
        names = ("stamp_s", "var_east_m2", "var_north_m2", "cov_east_north_m2", "var_yaw_rad2")
        columns = [column for column in map(table.get, names) if isinstance(column, np.ndarray)]
        if len(columns) != len(names):
            return None
        covariance = np.zeros((len(columns[0]), 3, 3))
        covariance[:, 0, 0], covariance[:, 1, 1] = columns[1], columns[2]
        covariance[:, 0, 1] = covariance[:, 1, 0] = columns[3]
        covariance[:, 2, 2] = columns[4]
        return columns[0], covariance

    def output_table(self) -> Mapping[str, Floats | list[str]] | None:
        """Columns of output.csv, numbers as arrays, where the run kept it.

        Raises:
            InputError: it is there but damaged.
        """
        if self.folder is None or not (self.folder / "output.csv").is_file():
            return None
        path = self.folder / "output.csv"
        table = _read_table(path)
        check_table(path, table, self.kf.stamp_s, "kf.tum")
        return table

    def on_poles_from_s(self) -> float:
        """First stamp of the output that a pose on poles has reached; -inf where none has.

        Raises:
            InputError: output.csv is needed, of a run of an earlier version, and damaged.
        """
        stated = self.metrics.get("on_poles_from_s")
        if stated is None and "on_poles_from_s" not in self.metrics:
            table = self.output_table() or {}
            stamps, ages = table.get("stamp_s"), table.get("pose_age_s")
            if isinstance(stamps, np.ndarray) and isinstance(ages, np.ndarray):
                stated = first_on_poles_s(stamps, ages)
        return float(stated) if isinstance(stated, int | float) else -inf

    def health_numbers(self, *names: str) -> Floats | None:
        """The first of the columns that exists and holds numbers."""
        for name in names:
            column = self.health.get(name)
            if isinstance(column, np.ndarray):
                return column
        return None


@dataclass(frozen=True, slots=True)
class RunSet:
    """All runs of one `polemap localize` call: the same drive, map and settings, several seeds."""

    path: Path
    config: Mapping[str, Any]
    runs: tuple[Run, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def name(self) -> str:
        """The folder's name, which is what the user calls this run."""
        return Path(os.path.realpath(self.path)).name

    @property
    def drive(self) -> Path | None:
        """Where the drive stood, if the run says so."""
        return self._path("drive")

    @property
    def topics(self) -> Path | None:
        """Mapping of the topics of the log that the drive was."""
        return self._path("topics")

    @property
    def map(self) -> Path | None:
        """Where the map stood, if the run says so."""
        return self._path("map")

    @property
    def lap(self) -> str | None:
        """The row of laps.csv that the run was restricted to."""
        lap = self.config.get("lap")
        return None if lap is None else str(lap)

    def _path(self, key: str) -> Path | None:
        """A path as the run wrote it, or seen from a folder above the run where it was relative."""
        value = self.config.get(key)
        if not value:
            return None
        path = Path(str(value))
        # os.path: a name that no system can have does not exist either
        if path.is_absolute() or os.path.exists(path):
            return path
        above = (parent / path for parent in Path(os.path.realpath(self.path)).parents)
        return next((place for place in above if os.path.exists(place)), path)


def read_run_set(path: Path, *, allow_without_poles: bool = False) -> RunSet:
    """Read a run folder, or a folder of runs 000, 001, ... .

    Args:
        allow_without_poles: accept runs without a particle filter, whose pf.tum is empty.

    Raises:
        InputError: neither of them, or one of its files is missing or damaged.
    """
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such run folder; 'polemap localize ... --out RUN' writes one")
    folders = sorted(
        (child for child in path.iterdir() if child.is_dir() and child.name.isdigit()),
        key=lambda child: int(child.name),
    )
    if not folders:
        if not (path / "kf.tum").is_file():
            raise InputError(
                f"{path}: is not a run folder (it has neither kf.tum nor runs 000, 001, ...); "
                "'polemap localize ... --out RUN' writes one"
            )
        folders = [path]
    configs = [_read_config(folder / "config.yaml") for folder in folders]
    runs = [
        _read_run(folder, config, number, allow_without_poles)
        for number, (folder, config) in enumerate(zip(folders, configs, strict=True))
    ]
    notes = _differences(path, configs)
    return RunSet(path, configs[0], tuple(runs), notes)


def _read_run(
    folder: Path, config: Mapping[str, Any], number: int, allow_without_poles: bool
) -> Run:
    seed = config.get("seed", number)
    if not isinstance(seed, int):
        raise InputError(f"{folder / 'config.yaml'}: seed = {seed!r} is not a whole number")
    timing = folder / "timing.csv"
    if config.get("map", "") is None and not allow_without_poles:
        raise InputError(
            f"{folder}: was localized --without-poles, so there is no particle filter to report "
            f"on; its metrics.json has its errors, and --add NAME={folder / 'kf.tum'} sets it "
            "beside a run in a map"
        )
    pf = read_tum(folder / "pf.tum", allow_empty=allow_without_poles)
    health = _read_table(folder / "health.csv")
    check_table(folder / "health.csv", health, pf.stamp_s, "pf.tum")
    timings = _read_table(timing) if timing.is_file() else {}
    check_table(timing, timings, pf.stamp_s, "pf.tum")
    return Run(
        seed=seed,
        pf=pf,
        kf=read_tum(folder / "kf.tum"),
        health=health,
        timings={key: column for key, column in timings.items() if isinstance(column, np.ndarray)},
        metrics=read_metrics(folder / "metrics.json"),
        folder=folder,
    )


def _differences(path: Path, configs: list[Mapping[str, Any]]) -> tuple[str, ...]:
    """A set whose runs differ in more than the seed is no Monte Carlo set: say so."""
    first = {key: value for key, value in configs[0].items() if key != "seed"}
    for number, config in enumerate(configs[1:], start=1):
        rest = {key: value for key, value in config.items() if key != "seed"}
        if rest != first:
            keys = sorted(k for k in first.keys() | rest.keys() if first.get(k) != rest.get(k))
            return (f"{path.name}: run {number} differs from run 0 in {', '.join(keys)}",)
    return ()


def _read_config(path: Path) -> Mapping[str, Any]:
    _check_there(path)
    with named(path, InputError, "run configuration"):
        tree = read_yaml(path)
    if not isinstance(tree, dict):
        raise InputError(f"{path}: expected settings, found {type(tree).__name__}")
    return tree


def read_metrics(path: Path) -> Mapping[str, Any]:
    """Content of metrics.json.

    Raises:
        InputError: it is missing, is no JSON object, or holds figures that are no numbers.
    """
    _check_there(path)
    with named(path, InputError, "metrics file"):
        metrics = read_json(path)
    if not isinstance(metrics, dict):
        raise InputError(f"{path}: expected an object, found {type(metrics).__name__}")
    check_metrics(path, metrics)
    return metrics


def _read_table(path: Path) -> dict[str, Floats | list[str]]:
    """A CSV file by columns; a column of numbers (or empty cells) becomes an array."""
    _check_there(path)
    with named(path, InputError, "table"):
        rows = read_rows(path)
    if not rows:
        raise InputError(f"{path}: is empty, a header line was expected")
    header, body = rows[0], [row for row in rows[1:] if row]
    for number, row in enumerate(body, start=2):
        if len(row) != len(header):
            raise InputError(f"{path}:{number}: {len(row)} cells, the header has {len(header)}")
    return {name: _column([row[i] for row in body]) for i, name in enumerate(header)}


def _column(cells: list[str]) -> Floats | list[str]:
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells], dtype=np.float64)
    except ValueError:
        return cells


def _check_there(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: missing; is this a folder of 'polemap localize'?")
