"""Poses and poles without a reference: small loops, what is missing, what is wrong."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.build.slam import rounds
from polemap.build.slam.loop import STRAIN_PROBABILITY, Found, Loop
from polemap.build.slam.motion import CALIBRATION
from polemap.build.slam.report import sentences
from polemap.build.slam.submaps import Submap
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.extras import MissingExtraError
from polemap.simulate.points.poles import Poles
from polemap.vehicle.kalman import chi_square_gate, chi_square_quantile
from tests.polemap.build.slam.loops import (
    GNSS,
    Simulated,
    beside,
    block,
    pose_errors,
    rounded,
    simulated,
    solve,
    yaw_errors,
)

pytest.importorskip("gtsam")
LAP = 330


def made(seed: int, *, gnss: bool = True, laps: float = 2.2) -> Simulated:
    rng = np.random.default_rng(seed)
    poses = block(laps)
    poles = beside(poses[:LAP], 6.0, rng)
    return simulated(poses, poles, rng, gnss=GNSS if gnss else None)


def first_fixes(drive: Drive, count: int) -> Drive:
    assert drive.gnss is not None
    return replace(drive, gnss=drive.gnss.take(slice(0, count)))


@pytest.mark.parametrize("seed", [101, 102])
def test_a_block_driven_twice_is_solved_by_gnss_and_poles(seed: int) -> None:
    sim = made(seed)
    result = solve(sim.drive)
    off, laid = pose_errors(result, sim.truth)
    assert np.quantile(laid, 0.95) < 0.25
    assert np.quantile(yaw_errors(result, sim.truth), 0.95) < 0.02
    covariance = result.trajectories[0].covariance
    assert covariance is not None
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    # one error of the receiver for the whole drive: within four of its deviations
    sd = np.sqrt(np.trace(covariance[:, :2, :2].mean(axis=0)) / 2.0)
    assert np.median(off) < sd * np.sqrt(chi_square_quantile(0.9999, 2))
    summary = result.summary
    assert summary.loops > 5
    assert summary.absolute
    assert summary.links_given_up <= 0.1 * summary.links
    assert summary.drives[0].relative_sd_m[0] < summary.drives[0].absolute_sd_m[0]
    assert set(summary.drives[0].calibration) == set(CALIBRATION)
    assert "built without reference:" in sentences(summary)[0]


def test_without_gnss_the_map_stands_in_a_local_frame_and_says_so() -> None:
    sim = made(103, gnss=False)
    result = solve(sim.drive)
    _, laid = pose_errors(result, sim.truth)
    assert np.quantile(laid, 0.95) < 0.4
    assert result.frame.kind == "local"
    assert not result.summary.absolute
    assert "local frame" in "\n".join(sentences(result.summary))


def test_one_fix_places_the_map_and_the_poles_shape_it() -> None:
    sim = made(104)
    result = solve(first_fixes(sim.drive, 1))
    _, laid = pose_errors(result, sim.truth)
    assert np.quantile(laid, 0.95) < 0.4
    assert result.summary.drives[0].fixes == 1


def test_fixes_that_are_wrong_altogether_do_not_bend_the_map() -> None:
    sim = made(105)
    gnss = sim.drive.gnss
    assert gnss is not None
    wrong = np.arange(len(gnss)) % 7 == 3
    drive = replace(
        sim.drive,
        gnss=gnss.with_columns(
            east_m=gnss.east_m + 120.0 * wrong, north_m=gnss.north_m - 40.0 * wrong
        ),
    )
    result = solve(drive)
    _, laid = pose_errors(result, sim.truth)
    assert np.quantile(laid, 0.95) < 0.3
    assert result.summary.drives[0].fixes_left_out >= 3


def test_two_drives_are_laid_onto_each_other() -> None:
    rng = np.random.default_rng(106)
    poses = block(1.3)
    poles = beside(poses[:LAP], 6.0, rng)
    drives = [simulated(poses, poles, rng).drive for _ in range(2)]
    result = solve(*drives)
    stamps = 0.1 * np.arange(len(poses))
    first, second = (part.at(stamps) for part in result.references)
    known = np.isfinite(first[:, 0]) & np.isfinite(second[:, 0])
    # both went the same way, so that they differ by what they are off to each other
    assert np.quantile(np.hypot(*(first - second)[known, :2].T), 0.95) < 0.35


def test_a_drive_that_sees_nothing_follows_odometry_and_fixes() -> None:
    sim = made(107, laps=1.0)
    blank = tuple(scan.take(np.zeros(len(scan), dtype=np.bool_)) for scan in sim.drive.scans)
    result = solve(replace(sim.drive, scans=blank))
    off, _ = pose_errors(result, sim.truth)
    assert np.median(off) < 6.0
    assert result.summary.loops == 0


def test_what_cannot_be_solved_is_named() -> None:
    sim = made(108, laps=0.5)
    with pytest.raises(InputError, match=r"drive drive 0: it has no scan"):
        solve(replace(sim.drive, scans=()))
    with pytest.raises(InputError, match=r"has no odometry.*add odometry.csv"):
        solve(replace(sim.drive, odometry=None))
    odometry = sim.drive.odometry
    assert odometry is not None
    still = odometry.with_columns(speed_mps=np.zeros(len(odometry)))
    with pytest.raises(InputError, match="the car stood still"):
        solve(replace(sim.drive, odometry=still))
    with pytest.raises(InputError, match="drive drive 1: it has no GNSS fix"):
        solve(sim.drive, replace(sim.drive, gnss=None))


def test_without_gtsam_one_line_says_what_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = made(109, laps=0.5)
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(MissingExtraError, match=r"needs gtsam.*polemap\[slam\]"):
        solve(sim.drive)


def test_the_same_drive_is_solved_alike_twice() -> None:
    sim = made(110, laps=1.2)
    one, two = solve(sim.drive), solve(sim.drive)
    np.testing.assert_array_equal(one.references[0].poses, two.references[0].poses)


def test_identical_avenues_side_by_side_are_not_taken_for_one() -> None:
    # two straight rows of equal trees, 25 m apart, in a serpentine that drives each once
    rng = np.random.default_rng(111)
    along = np.arange(5.0, 150.0, 10.0)
    rows = [np.column_stack([along, np.full(len(along), y)]) for y in (-5.0, 5.0, 35.0, 45.0)]
    points = np.concatenate(rows)
    n = len(points)
    poles = Poles(points, np.full(n, 0.3), np.full(n, 0.9))
    corners = np.array([[0.0, 0.0], [155.0, 0.0], [155.0, 40.0], [0.0, 40.0]])
    poses = rounded(corners, 0.8, 0.88)
    sim = simulated(poses, poles, rng, gnss=None)
    result = solve(sim.drive)
    _, laid = pose_errors(result, sim.truth)
    assert laid.max() < 6.0


def test_a_wrong_loop_is_found_by_its_strain_and_taken_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sim = made(101)
    right = solve(sim.drive)
    found = rounds.find_loops
    wrong: list[Loop] = []

    def with_a_wrong_one(
        submaps: Sequence[Submap], anchors: NDArray[np.float64], *rest: Any, **more: Any
    ) -> Found:
        result = found(submaps, anchors, *rest, **more)
        if not wrong:
            # two ends of the block for one place, by a single pair of poles, which ties little
            a, b = submaps[0], submaps[3]
            pair = np.array([[a.landmark[0], b.landmark[0]]])
            at = np.array([1.0, 2.0, 0.1])
            wrong.append(Loop(0, 3, pair, 99.0, np.zeros(3), at))
        return replace(result, loops=(*result.loops, *wrong))

    monkeypatch.setattr(rounds, "find_loops", with_a_wrong_one)
    result = solve(sim.drive)
    back = [one for one in result.summary.places if one.taken_back]
    gate = chi_square_gate(STRAIN_PROBABILITY, 3)
    assert any(one.log_odds == 99.0 and one.strain > gate for one in back)
    assert all(one.log_odds < 99.0 for one in result.summary.places if not one.taken_back)
    off, _ = pose_errors(result, sim.truth)
    assert np.quantile(np.abs(off - pose_errors(right, sim.truth)[0]), 0.95) < 0.1


def test_strain_is_the_squared_distance_in_deviations() -> None:
    anchors = np.array([[0.0, 0.0, np.pi / 2], [0.0, 10.0, np.pi / 2]])
    none = np.empty((0, 2), dtype=np.int64)
    loop = Loop(0, 1, none, 9.0, np.zeros(3), np.array([10.0, 0.0, 2.0 * np.pi]))
    assert loop.strain(anchors) == pytest.approx(0.0, abs=1e-9)
    moved = replace(loop, measured=np.array([10.3, -0.15, 0.02]))
    assert moved.strain(anchors) == pytest.approx(4.0 + 1.0 + 4.0)


def test_a_drive_that_is_given_twice_is_named() -> None:
    sim = made(101, laps=1.0)
    with pytest.raises(InputError, match="drive drive 1: its odometry is that of drive drive 0"):
        solve(sim.drive, replace(sim.drive, name="again"))
