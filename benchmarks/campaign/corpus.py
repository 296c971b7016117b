"""Small valid files of every kind that polemap reads, made here, and the reader of each."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import yaml

from benchmarks.campaign.corpus_drives import (
    Add,
    add_calibrations,
    add_kitti,
    add_logger,
    add_logs,
    add_recordings,
    open_whole,
)
from polemap.detect.models.io import read_classifier, write_classifier
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.images import read_grey
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tum import read_tum
from polemap.electric.comma2k19.io import FILES as COMMA_FILES
from polemap.electric.comma2k19.io import read_comma2k19
from polemap.electric.io import read_mapping
from polemap.evaluation.runs.io import read_run_set
from polemap.map.io import export_map, read_map, write_map
from polemap.map.pole_map import PoleMap
from polemap.parsing.arrays import read_arrays
from polemap.settings import load_settings
from polemap.simulate.scenario import load_scenario
from polemap.tools.detection_cache import read_scans
from polemap.vehicle.io import dump_car, load_car
from tests.drivelog.drives import write_small

FRAME = EarthFrame("utm", 32632)


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of file: `file` is damaged, then `read` is called.

    Attributes:
        seed: the bytes of the valid file.
    """

    name: str
    file: Path
    seed: bytes
    read: Callable[[], Any]


def make_corpus(folder: Path) -> list[Kind]:
    """Write one valid file of every kind below `folder`; each in a place of its own."""
    kinds: list[Kind] = []

    def add(name: str, file: Path, read: Callable[[], Any]) -> None:
        read()  # a corpus that cannot be read is no corpus
        kinds.append(Kind(name, file, file.read_bytes(), read))

    drive = write_small(folder / "drive")
    for file in ("drive.yaml", "frames.csv", "odometry.csv", "gnss.csv", "reference.csv",
                 "poles.csv", "scans.csv", "laps.csv"):  # fmt: skip
        # a drive with this file alone is read in a fifth of the time
        lean = folder / f"lean-{file}"
        lean.mkdir()
        for name in {"drive.yaml", file}:
            shutil.copy(drive / name, lean / name)
        if file == "frames.csv":
            for side in ("left", "right"):
                shutil.copytree(drive / side, lean / side)
        add(f"folder/{file}", lean / file, partial(open_whole, lean))
    _maps(folder, add)
    _pictures(folder, add)
    add_kitti(folder, open_drive(drive), add)
    add_recordings(folder, open_drive(drive), add)
    _runs(folder, add)
    _settings(folder, add)
    add_logs(folder, add)
    add_logger(folder, add)
    add_calibrations(folder, add)
    _segment(folder, add)
    _caches(folder, add)
    return kinds


def _poles() -> PoleMap:
    points = np.random.default_rng(0).uniform(0.0, 300.0, (6, 2)) + np.array([458000.0, 5.43e6])
    n = len(points)
    return PoleMap(
        FRAME, np.arange(n), points, np.tile(np.eye(2) * 0.01, (n, 1, 1)), np.full(n, 0.3),
        np.full(n, 4.0), np.ones(n, dtype=np.int64), np.ones(n, dtype=np.int64), np.ones(n),
        extra={"note": np.array(["a", "b", "c", "d", "e", "f"])},
    )  # fmt: skip


def _maps(folder: Path, add: Add) -> None:
    for ending in ("gpkg", "geojson", "parquet", "osm", "pbf"):
        path = folder / f"map.{ending}"
        export_map(_poles(), path) if ending in ("osm", "pbf") else write_map(_poles(), path)
        add(f"map.{ending}", path, partial(read_map, path, FRAME))
        add(f"map.{ending} alone", path, partial(read_map, path))
    path = folder / "map.csv"
    path.write_text("east_m,north_m,width_m\n458000.5,5430000.25,0.3\n458010,5430020,\n")
    add("map.csv", path, lambda: read_map(path, FRAME))


def _pictures(folder: Path, add: Add) -> None:
    grey = np.random.default_rng(1).integers(0, 255, (12, 16)).astype(np.uint8)
    deep = grey.astype(np.uint16) * 16
    colour = np.dstack([grey] * 3)
    for name, picture in (("a.png", grey), ("b.png", deep), ("c.png", colour), ("d.jpg", colour),
                          ("e.bmp", grey), ("f.pgm", grey), ("g.tiff", deep)):  # fmt: skip
        path = folder / name
        path.write_bytes(cv2.imencode(path.suffix, picture)[1].tobytes())
        add(f"picture {name}", path, partial(read_grey, path))


def _runs(folder: Path, add: Add) -> None:
    run = folder / "run"
    run.mkdir()
    pose = "100.0 458000.5 5430000.25 0 0 0 0.1 0.99\n100.1 458001.5 5430000.25 0 0 0 0.1 0.99\n"
    (run / "pf.tum").write_text(pose)
    (run / "kf.tum").write_text(pose)
    (run / "health.csv").write_text("stamp_s,matched,event\n100.0,3,\n100.1,2,lost\n")
    (run / "timing.csv").write_text("stamp_s,update_ms\n100.0,3.5\n100.1,2\n")
    (run / "output.csv").write_text(
        "stamp_s,var_east_m2,var_north_m2,cov_east_north_m2,var_yaw_rad2\n100,1,1,0,0.1\n"
        "100.1,1,1,0,0.1\n"
    )
    (run / "config.yaml").write_text(
        yaml.safe_dump({"drive": "d", "map": "m", "lap": None, "seed": 3, "settings": {"a": [1]}})
    )
    (run / "metrics.json").write_text(
        json.dumps({"pf": {"lateral_rmse_m": 0.1}, "notes": ["x"], "timing_ms": {"update": {}}})
    )

    def use() -> None:
        runs = read_run_set(run)
        runs.runs[0].output_covariance()
        _ = runs.drive, runs.map, runs.lap

    for file in sorted(run.iterdir()):
        add(f"run/{file.name}", file, use)
    add("tum", run / "pf.tum", lambda: read_tum(run / "pf.tum"))


def _settings(folder: Path, add: Add) -> None:
    config = folder / "config.yaml"
    config.write_text("localize:\n  particles: 150\nstereo: {matcher: census_sgm}\n")
    add("settings", config, lambda: load_settings(config))
    scenario = folder / "mine.yaml"
    scenario.write_text(
        "name: mine\nroute: {corners_m: [[0, 0], [100, 0], [100, 80]], closed: false}\n"
        "rows:\n- {kind: lamp, spacing_m: 20}\nlight: {sun: 1.0}\n"
    )
    add("scenario", scenario, lambda: load_scenario(scenario))
    car = folder / "car.yaml"
    car.write_text(dump_car(load_car("coms")))
    add("car", car, lambda: load_car(car))
    mapping = folder / "mapping.yaml"
    mapping.write_text("stamp_s: t\nvx_mps: {column: v, scale: 0.278}\n")
    add("mapping", mapping, lambda: read_mapping(mapping))
    classifier = folder / "poles.json"
    write_classifier(read_classifier("default"), classifier)
    add("classifier", classifier, lambda: read_classifier(str(classifier)))


def _segment(folder: Path, add: Add) -> None:
    """A comma2k19 folder: a car that drives straight on to the north for half a minute."""
    place = folder / "segment"
    place.mkdir()
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 30.0, 0.1)
    zero, speed = np.zeros(len(t)), 10.0 + np.sin(t)
    columns = {
        "accelerometer": (np.cos(t), zero, zero - 9.8),
        "gyro": (zero, zero, 0.01 * rng.standard_normal(len(t))),
        "wheel_speed": 4 * (speed,),
        "steering": (np.sin(t),),
        "gnss": (speed, zero, 1.5e12 + 1e3 * t),
        # on the equator at longitude 0 the earth's axis points north
        "reference": (zero, zero, speed, zero + 0.5**0.5, zero, zero - 0.5**0.5, zero),
    }
    for name, values in columns.items():
        table = pd.DataFrame({"stamp_s": t, **dict(zip(COMMA_FILES[name], values, strict=True))})
        if name == "reference":
            table = table.assign(ecef_x_m=6_378_137.0, ecef_y_m=0.0, ecef_z_m=0.0)
        table.to_csv(place / f"{name}.csv", index=False)
    for file in sorted(place.iterdir()):
        add(f"comma2k19/{file.name}", file, lambda: read_comma2k19(place, 15.0))


def _caches(folder: Path, add: Add) -> None:
    path = folder / "scans.npz"
    arrays: dict[str, Any] = {
        "format": np.array(2), "spent": np.zeros((2, 2)), "stamps": np.array([[1.0, 1.1], [2, 2]]),
        "counts": np.array([1, 0]), "points": np.ones((1, 2)), "covariance": np.ones((1, 2, 2)),
        "width": np.ones(1), "existence": np.ones(1), "height": np.ones(1),
        "bins": np.array([-1, 1]), "sector": np.zeros((2, 5)), "free": np.ones(1),
    }  # fmt: skip
    with path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
    add("cache", path, lambda: read_scans(path))
    add("arrays", path, lambda: read_arrays(path))
