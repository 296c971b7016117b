"""Corners that do not fit accuse their map where poles hold the place, and both where none does."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from polemap.drivelog.detections import Detections, pole_detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.particle_filter.corner_trust import CornerTrust
from polemap.localize.particle_filter.landmarks import Landmarks

KNOWN = np.diag([0.01, 0.01, 1e-5])
SHARE, SD_M = 0.12, 0.1
STREET = np.column_stack([np.arange(0.0, 400.0, 12.0), np.tile([8.0, -8.0], 17)])
NONE = np.empty(0, dtype=np.int64)


def mapped(points: np.ndarray) -> Landmarks:
    n = len(points)
    return Landmarks(
        np.full(n, LandmarkKind.CORNER, dtype=np.int8), points, np.tile([0.0025, 0.0025, 0.0],
        (n, 1)), np.full(n, np.nan), np.full(n, 0.5), np.arange(n), np.zeros(n),
    )  # fmt: skip


def seen(stamp_s: float, at_m: float, rng: np.random.Generator) -> Detections:
    local = STREET - [at_m, 0.0]
    local = local[(local[:, 0] > 4.0) & (local[:, 0] < 28.0)]
    local = local + SD_M * rng.standard_normal(local.shape)
    n = len(local)
    scan = pole_detections(stamp_s, stamp_s, local, np.tile(SD_M**2 * np.eye(2), (n, 1, 1)))
    return scan.with_columns(
        kind=np.full(n, LandmarkKind.CORNER, dtype=np.int8), facing_rad=np.zeros(n)
    )


def drive(
    trust: CornerTrust, points: np.ndarray, *, poles: bool, from_m: float = 0.0,
    place: np.ndarray = KNOWN, length_m: float = 100.0, seed: int = 0,
) -> list[bool]:  # fmt: skip
    """Past a street at 10 m/s; whether its corners were believed."""
    rng, believed = np.random.default_rng(seed), []
    for k in range(round(2.0 * length_m)):
        at_m = from_m + 0.5 * k
        scan, pose = seen(0.1 * at_m, at_m, rng), np.array([at_m, 0.0, 0.0])
        believed.append(trust.believed(scan, mapped(points), pose, place, place, SHARE, 0.0))
        trust.add_matched(
            0.1 * at_m, np.array([7, 9]) if poles else NONE, NONE, SHARE, contradicted=False
        )
    return believed


def test_corners_of_a_right_map_are_believed() -> None:
    counts: Counter[str] = Counter()
    for seed in range(2):
        assert all(drive(CornerTrust(counts), STREET, poles=True, length_m=250.0, seed=seed))
    assert not counts


@pytest.mark.parametrize("poles", [True, False])
@pytest.mark.parametrize("aside_m", [0.5, 1.0, 3.0])
def test_houses_that_moved_are_left_out_and_come_back(aside_m: float, poles: bool) -> None:
    counts: Counter[str] = Counter()
    trust = CornerTrust(counts)
    believed = drive(trust, STREET - [0.0, aside_m], poles=poles)
    assert not any(believed[120:])
    assert counts["corners_suspended"] == 1
    # where poles hold the place it is the map that is wrong
    assert trust.doubted == (not poles)
    assert all(drive(trust, STREET, poles=True, from_m=100.0, length_m=150.0)[200:])
    assert not trust.doubted


def test_corners_of_another_street_are_left_out() -> None:
    elsewhere = np.random.default_rng(3).uniform([0.0, -12.0], [400.0, 12.0], (34, 2))
    assert not any(drive(CornerTrust(Counter()), elsewhere, poles=True)[120:])


def test_a_place_that_was_lost_is_found_by_several_corners_or_poles_only() -> None:
    trust = CornerTrust(Counter())
    drive(trust, STREET, poles=False, place=np.diag([2.0, 0.1, 1e-4]), length_m=5.0)
    assert not trust.found
    for corners in ([3], [3], [3, 4]):
        trust.add_matched(1.0, NONE, np.array(corners), SHARE, contradicted=False)
        assert not trust.found
    trust.add_matched(1.0, NONE, np.array([5]), SHARE, contradicted=False)
    assert trust.found
    drive(trust, STREET, poles=False, place=np.diag([2.0, 0.1, 1e-4]), length_m=1.0)
    trust.add_matched(1.0, np.array([1]), NONE, SHARE, contradicted=False)
    assert not trust.found
    trust.add_matched(1.0, np.array([2]), NONE, SHARE, contradicted=False)
    assert trust.found


def test_suspended_corners_that_find_a_lost_place_do_not_prove_it() -> None:
    trust = CornerTrust(Counter())
    drive(trust, STREET - [0.0, 1.0], poles=True)
    assert trust.suspended
    lost = np.diag([4.0, 4.0, 1e-3])
    assert drive(trust, STREET, poles=False, from_m=100.0, place=lost, length_m=1.0)[-1]
    drive(trust, STREET, poles=False, from_m=101.0, length_m=50.0)
    assert trust.doubted
