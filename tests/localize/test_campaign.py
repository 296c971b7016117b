"""The campaign's measure, and a few of its kinds on a seed each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.campaign import contradictions
from benchmarks.campaign.car_parks import hard_car_park
from benchmarks.campaign.drives import car_park, street
from benchmarks.campaign.fault_kinds import KINDS
from benchmarks.campaign.faults import twice
from benchmarks.campaign.held_out import HELD_OUT
from benchmarks.campaign.judge import stretches


def test_only_stretches_longer_than_the_patience_count() -> None:
    stamps = np.arange(0.0, 10.0, 0.1)
    flag = ((stamps > 0.95) & (stamps < 1.85)) | ((stamps > 3.95) & (stamps < 6.05))
    assert stretches(stamps, flag, 1.0) == pytest.approx(2.0)
    assert stretches(stamps, ~flag, 1.0) == pytest.approx(2.0 + 3.8)
    assert stretches(stamps, np.zeros(100, dtype=bool), 1.0) == 0.0


@pytest.mark.parametrize("kind", ["speed 0 for 0.5 s", "speed x 1.8 for 1 s", "silent for 1 s"])
def test_lies_of_the_odometry_are_noticed(kind: str) -> None:
    row = contradictions.one((kind, 0))
    for name in ("pf", "kf"):
        assert row[name]["silent_s"] == 0.0
        assert row[name]["outcome"] == "degraded and reported"
        assert row[name]["back_s"] < 5.0


def test_a_campaign_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    done = tmp_path / "rows.jsonl"
    done.write_text('{"kind": "none", "seed": 0, "pf": {}, "kf": {}}\n', encoding="utf-8")
    rows = contradictions.run_all(["none"], range(1), done, workers=1)
    assert rows == [{"kind": "none", "seed": 0, "pf": {}, "kf": {}}]


def test_a_crash_is_an_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(seed: int) -> None:
        raise ValueError("no drive")

    monkeypatch.setitem(KINDS, "broken", broken)  # type: ignore[arg-type]
    row = contradictions.one(("broken", 0))
    assert row["kf"]["outcome"] == "crash: ValueError: no drive"
    assert "1 CRASHES" in list(contradictions.table([row]))[1]


def test_the_drives_are_what_they_claim() -> None:
    case = car_park(0)
    odometry, reference = case.drive.odometry, case.drive.reference
    assert odometry is not None
    assert reference is not None
    turned = np.unwrap(reference.poses[:, 2])
    true = np.gradient(turned, reference.stamp_s)
    at = np.interp(odometry.stamp_s, reference.stamp_s, true)
    tight = np.abs(at) > 0.4
    ratio = np.median(odometry.yaw_rate_radps[tight] / at[tight])
    assert ratio == pytest.approx(0.93, abs=0.01)
    assert sum(len(scan) == 0 for scan in case.scans) >= 2 * 4 * 11
    doubled = twice(street(0).pole_map, 1.0, 0.3, 0.0)
    half = len(doubled) // 2
    assert np.allclose(np.hypot(*(doubled.points_m[half:] - doubled.points_m[:half]).T), 1.0)


def test_a_hard_car_park_stops_turns_tightly_and_goes_back() -> None:
    case = hard_car_park(0, "grid")
    odometry = case.drive.odometry
    assert odometry is not None
    assert odometry.speed_mps.min() < -0.5
    assert odometry.speed_mps.max() < 3.0
    assert (np.abs(odometry.speed_mps) < 0.2).mean() > 0.05
    moving = np.abs(odometry.speed_mps) > 1.0
    bend = np.abs(odometry.yaw_rate_radps[moving] / odometry.speed_mps[moving])
    assert np.quantile(bend, 0.95) > 0.15
    # poles repeat themselves: most have a neighbour a grid's step away
    points = case.pole_map.points_m
    step = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    assert (np.abs(step - 8.0) < 0.5).any(axis=1).mean() > 0.8


def test_held_out_kinds_are_others_and_can_be_made() -> None:
    assert not set(HELD_OUT) & set(KINDS)
    for name in ("every scan twice", "odometry's lag grows to 0.4 s over 12 s"):
        faulty = HELD_OUT[name](0)
        plain = street(0)
        changed = len(faulty.case.scans) != len(plain.scans)
        odometry, sound = faulty.case.drive.odometry, plain.drive.odometry
        assert odometry is not None
        assert sound is not None
        assert changed or not np.array_equal(odometry.speed_mps, sound.speed_mps)
