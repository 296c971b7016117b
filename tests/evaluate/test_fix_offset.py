"""Fixes to one side of the poses: named where their error cannot explain it, and only there."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from polemap.drivelog.drive import Drive, GnssStream
from polemap.drivelog.frames import EarthFrame
from polemap.evaluation.fix_offset import FixOffset, fix_offset
from polemap.evaluation.verdict import judge
from polemap.localize.config import GnssConfig
from polemap.localize.replay import Run
from polemap.vehicle.pose import rotation
from polemap.vehicle.trajectory import Trajectory
from tests.pole_maps import plain_map

GNSS = GnssConfig()


def drive_and_run(
    seconds: float, seed: int, *, shift_m: float = 0.0, turn_rad: float = 0.0, healthy: bool = True
) -> tuple[Drive, Run]:
    """Laps of 200 m radius with Gauss-Markov fixes, in a map that is moved or turned."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(0.0, seconds)
    angle = 10.0 / 200.0 * stamps
    places = 200.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    keep = np.exp(-1.0 / GNSS.correlation_s)
    error = np.zeros((len(stamps), 2))
    error[0] = GNSS.sd_m * rng.standard_normal(2)
    for k in range(1, len(stamps)):
        error[k] = keep * error[k - 1] + np.sqrt(1 - keep**2) * GNSS.sd_m * rng.standard_normal(2)
    drive = Drive(
        name="laps", path=Path("laps"), frame=EarthFrame("local", name="test"), wheelbase_m=2.7,
        gnss=GnssStream(
            stamps, stamps, *(places + error).T, np.ones(len(stamps))
        ),
    )  # fmt: skip
    mapped = places @ rotation(turn_rad).T + [shift_m, 0.0]
    poses = np.column_stack([mapped, angle + np.pi / 2 + turn_rad])
    n = len(stamps)
    covariance = np.tile(np.diag([0.01, 0.01, 1e-4]), (n, 1, 1))
    kf = Trajectory(stamps, poses, covariance)
    run = Run(
        pf=kf, updates=cast(Any, ()), kf=kf, output=np.zeros((n, 4)), flags=("",) * n,
        distrust=("" if healthy else "spread",) * n, counts={},
    )  # fmt: skip
    return drive, run


def offset_of(drive: Drive, run: Run) -> FixOffset | None:
    return fix_offset(run, drive, GNSS)


def test_the_stated_deviation_is_that_of_the_offset_and_nothing_is_named_by_chance() -> None:
    found = [offset_of(*drive_and_run(1800.0, seed)) for seed in range(40)]
    scaled = np.array([[f.east_m / f.sd_m, f.north_m / f.sd_m] for f in found if f])
    # 80 normal numbers: the mean square lies within four deviations of one
    assert 0.4 < np.mean(scaled**2) < 1.7
    assert not any(f.finding for f in found if f)


def test_a_map_aside_or_turned_is_named_where_fixes_last() -> None:
    aside = offset_of(*drive_and_run(3600.0, 1, shift_m=-6.0))
    assert aside is not None
    assert "another frame" in aside.finding
    assert aside.east_m == pytest.approx(6.0, abs=4.0 * aside.sd_m)
    turned = offset_of(*drive_and_run(3600.0, 1, turn_rad=-0.03))
    assert turned is not None
    assert "turned by 1." in turned.finding
    # a minute cannot tell it from the receiver's own error
    short = offset_of(*drive_and_run(60.0, 1, shift_m=-4.0))
    assert short is not None
    assert not short.finding


def test_without_fixes_or_health_there_is_none() -> None:
    drive, run = drive_and_run(100.0, 0, healthy=False)
    assert fix_offset(run, drive, GNSS) is None
    drive, run = drive_and_run(2.0, 0)
    assert fix_offset(run, drive, GNSS) is None


def test_the_verdict_names_it() -> None:
    drive, run = drive_and_run(3600.0, 2, shift_m=-6.0)
    verdict = judge(run, drive, plain_map([[0.0, 0.0]]))
    assert "all along" in verdict["sentence"]
    assert verdict["trust"] != "trustworthy"
    assert verdict["fixes_offset_m"] > 3.0
