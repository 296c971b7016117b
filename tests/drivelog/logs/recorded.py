"""One journey, and a logger that writes it in whatever dialect a test asks for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import EarthFrame, convergence_rad, geographic_from_grid
from polemap.drivelog.readers.registry import open_drive
from polemap.tools import cli

Floats = NDArray[np.float64]
START_S = 1_714_564_800.0  # 2024-05-01 12:00 UTC, GPS week 2312, second 302418
ZONE = EarthFrame("utm", 32632)


@dataclass(frozen=True)
class Journey:
    """A car on a winding road, every 0.1 s; arrays `(n,)`."""

    stamp_s: Floats
    speed_mps: Floats
    yaw_rate_radps: Floats
    east_m: Floats
    north_m: Floats
    yaw_rad: Floats
    latitude_deg: Floats
    longitude_deg: Floats
    compass_deg: Floats


def journey(n: int = 600) -> Journey:
    """`n` samples; the same ones every time."""
    t = 0.1 * np.arange(n)
    speed = 9.0 + 3.0 * np.sin(0.11 * t)
    rate = 0.12 * np.sin(0.2 * t) + 0.05 * np.cos(0.07 * t)
    yaw = 0.3 + np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * 0.1)])
    middle, way = 0.5 * (yaw[1:] + yaw[:-1]), 0.5 * (speed[1:] + speed[:-1]) * 0.1
    east = 690_000.0 + np.concatenate([[0.0], np.cumsum(np.cos(middle) * way)])
    north = 5_330_000.0 + np.concatenate([[0.0], np.cumsum(np.sin(middle) * way)])
    points = np.stack([east, north], axis=1)
    place = geographic_from_grid(ZONE, points)
    compass = np.degrees(np.pi / 2.0 - (yaw - convergence_rad(ZONE, points))) % 360.0
    return Journey(START_S + t, speed, rate, east, north, yaw, place[:, 0], place[:, 1], compass)


def table(columns: Mapping[str, list[str]], separator: str = ",", header: bool = True) -> str:
    """Text of a CSV file."""
    lines = [separator.join(columns)] if header else []
    lines += [separator.join(row) for row in zip(*columns.values(), strict=True)]
    return "\n".join(lines) + "\n"


def cells(values: Floats, form: str = "%.9f", decimal: str = ".") -> list[str]:
    """Numbers as a logger writes them."""
    return [(form % value).replace(".", decimal) for value in values]


def clock(stamps: Floats, form: Callable[[datetime], str]) -> list[str]:
    """Stamps as texts."""
    return [form(datetime.fromtimestamp(stamp, UTC)) for stamp in stamps]


def write_mapping(path: Path, **sections: object) -> Path:
    """A mapping file of a car with a wheelbase."""
    tree = {"drive": {"vehicle": {"wheelbase_m": 2.7}}, **sections}
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return path


def convert(tmp_path: Path, log: str | bytes, sections: dict[str, Any], *words: str) -> Drive:
    """The drive that a log becomes by the command."""
    path = tmp_path / "log.csv"
    path.write_bytes(log.encode() if isinstance(log, str) else log)
    mapping = write_mapping(tmp_path / "map.yaml", **sections)
    arguments = ["convert", str(path), "--mapping", str(mapping), "--out", str(tmp_path / "drive")]
    assert cli.run([*arguments, *words]) == cli.GOOD
    return open_drive(tmp_path / "drive")


def columns(speed: str = "v", rate: str = "gz") -> dict[str, Any]:
    return {
        "speed_mps": {"column": speed, "unit": "km/h"},
        "yaw_rate_radps": {"column": rate, "unit": "deg/s"},
    }
