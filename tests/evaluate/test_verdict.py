"""The verdict of a run: what it rests on, and what it says of good, poor and lost runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from polemap.drivelog.drive import Drive, GnssStream, OdometryStream
from polemap.drivelog.frames import EarthFrame
from polemap.evaluation.verdict import built_from, judge, verdict_lines
from polemap.localize.replay import Run
from polemap.vehicle.trajectory import Trajectory
from tests.pole_maps import plain_map

T = np.arange(0.0, 60.0, 0.1)


def _drive(fix_off_m: float = 2.0) -> Drive:
    n = len(T)
    return Drive(
        name="monday",
        path=Path("monday"),
        frame=EarthFrame("local", name="test"),
        wheelbase_m=2.7,
        odometry=OdometryStream(T, T, np.full(n, 5.0), np.zeros(n)),
        gnss=GnssStream(T, T, 5.0 * T, np.full(n, fix_off_m), np.ones(n)),
    )


def _run(healthy: Sequence[bool], matched: Sequence[int], sd_m: float = 0.1) -> Run:
    updates = [
        SimpleNamespace(
            estimate=SimpleNamespace(
                healthy=one, stamp_s=float(t), health=SimpleNamespace(matched=count)
            )
        )
        for t, one, count in zip(T, healthy, matched, strict=True)
    ]
    n = len(T)
    poses = np.column_stack([5.0 * T, np.zeros(n), np.zeros(n)])
    covariance = np.tile(np.diag([sd_m**2, (0.5 * sd_m) ** 2, 1e-4]), (n, 1, 1))
    kf = Trajectory(T, poses, covariance)
    return Run(
        pf=kf, updates=cast(Any, tuple(updates)), kf=kf, output=np.zeros((n, 4)),
        flags=("",) * n, distrust=tuple("" if one else "lost" for one in healthy), counts={},
    )  # fmt: skip


GOOD, TWO = [True] * len(T), [2] * len(T)


def test_a_good_run_is_trustworthy_and_says_on_what_that_rests() -> None:
    verdict = judge(_run(GOOD, TWO), _drive(), plain_map([[1.0, 2.0]]))
    assert verdict["trust"] == "trustworthy"
    assert verdict["healthy_share"] == 1.0
    assert verdict["matched_poles_mean"] == 2.0
    assert verdict["position_sd_m"] == pytest.approx(0.1)
    assert verdict["fixes_to_pose_m"] == pytest.approx(2.0)
    assert verdict["longest_without_poles_s"] == pytest.approx(0.1)
    assert "100 % of the drive healthy" in "\n".join(verdict_lines(verdict))


@pytest.mark.parametrize(
    ("share", "fix_off_m", "sd_m", "gap_s", "trust", "reason"),
    [
        (0.8, 2.0, 0.1, 0.0, "partly", "80 %"),
        (0.3, 2.0, 0.1, 0.0, "not", "30 %"),
        (1.0, 20.0, 0.1, 0.0, "partly", "fixes 20 m"),
        (1.0, 5e6, 0.1, 0.0, "not", "fixes 5000000 m"),
        (1.0, 2.0, 0.9, 0.0, "partly", "0.90 m"),
        (1.0, 2.0, 0.1, 30.0, "partly", "30 s without"),
    ],
)
def test_what_speaks_against_a_run_decides(
    share: float, fix_off_m: float, sd_m: float, gap_s: float, trust: str, reason: str
) -> None:
    healthy = (np.arange(len(T)) < share * len(T)).tolist()
    matched = np.where((T > 10.0) & (10.0 + gap_s > T), 0, 2).tolist()
    verdict = judge(_run(healthy, matched, sd_m), _drive(fix_off_m), plain_map([[1.0, 2.0]]))
    assert verdict["trust"] == trust
    assert reason in verdict["sentence"]


def test_without_poles_a_run_is_never_trusted_in_full() -> None:
    empty = replace(_run(GOOD, TWO), updates=())
    assert judge(empty, _drive(), None)["trust"] == "partly"


@pytest.mark.parametrize(
    ("in_map", "driven", "same"),
    [
        ("monday", "monday", True),
        ("monday:lap_1", "monday", True),
        ("monday", "monday:lap_2", True),
        ("monday:lap_1", "monday:lap_2", False),
        ("tuesday", "monday", False),
    ],
)
def test_a_map_of_the_same_drive_is_told(in_map: str, driven: str, same: bool) -> None:
    entry = [{"drive": in_map, "start_s": 0.0, "seen": 3.0, "looks": 4.0, "passes": []}]
    text = json.dumps(entry, separators=(",", ":"))
    pole_map = replace(plain_map([[1.0, 2.0]]), extra={"history": np.array([text])})
    drive = replace(_drive(), name=driven)
    assert built_from(pole_map, drive) is same
    verdict = judge(_run(GOOD, TWO), drive, pole_map)
    assert verdict["map_built_from_this_drive"] is same
    assert ("flatter" in verdict["sentence"]) is same


def test_a_map_without_a_history_is_no_evidence() -> None:
    assert not built_from(plain_map([[1.0, 2.0]]), _drive())
