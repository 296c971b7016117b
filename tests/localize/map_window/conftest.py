"""A drive through several squares of a city, and its map in every format read by tiles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.localize import map_window
from polemap.simulate.points.drive import STREWN_CITY, PointDrive, gnss, simulate_points
from tests.city_maps import write_city
from tests.localize.map_window.driving import DURATION_S, KIDNAPPED_M, KIDNAPPED_S


@pytest.fixture(scope="module")
def drive() -> PointDrive:
    """Through several squares, and put further on from one to another."""
    scenario = replace(
        STREWN_CITY, duration_s=DURATION_S, poles_per_m2=0.01, gnss=gnss(wander_sd_m=0.7),
        kidnap_s=KIDNAPPED_S, kidnap_m=KIDNAPPED_M,
    )  # fmt: skip
    return simulate_points(scenario, np.random.default_rng(4))


@pytest.fixture(scope="module")
def files(drive: PointDrive, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_city(drive.pole_map, tmp_path_factory.mktemp("city"))


@pytest.fixture
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a drive of half a kilometre needs several; 175 m are needed by the search."""
    monkeypatch.setattr(map_window, "NEEDED_M", 190.0)
    monkeypatch.setattr(map_window, "LOADED_M", 260.0)
