"""Condensed drives: what they keep, that their order does not count, what they are solved to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.slam.condense import Condensed, condense
from polemap.build.slam.config import SlamConfig
from polemap.build.slam.io import read_condensed, write_condensed
from polemap.build.slam.motion import MotionNoise
from polemap.build.slam.skeleton import CondensedBuilder, solve_condensed
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.vehicle.pose import relative
from tests.polemap.build.slam.loops import (
    GNSS,
    Simulated,
    beside,
    block,
    pose_errors,
    simulated,
    solve,
)

pytest.importorskip("gtsam")
Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
KEY = "0" * 32


def condensed(drive: Drive, name: str) -> Condensed:
    bare = replace(drive, reference=None)
    return condense(
        name, bare, drive.scans, MappingConfig(), SlamConfig(), MotionNoise(), drive.frame
    )


@pytest.fixture(scope="module")
def sims() -> list[Simulated]:
    rng = np.random.default_rng(301)
    poses = block(1.4)
    poles = beside(poses[:330], 6.0, rng)
    return [simulated(poses, poles, rng, gnss=GNSS) for _ in range(2)]


@pytest.fixture(scope="module")
def parts(sims: list[Simulated]) -> list[Condensed]:
    return [condensed(sim.drive, f"drive {k}") for k, sim in enumerate(sims)]


def test_motions_between_nodes_are_right_within_what_they_state(
    sims: list[Simulated], parts: list[Condensed]
) -> None:
    part, truth = parts[0], sims[0].truth
    at = 0.1 * np.arange(len(truth))
    yaw = np.unwrap(truth[:, 2])
    true = np.column_stack(
        [np.interp(part.stamp_s, at, column) for column in (truth[:, 0], truth[:, 1], yaw)]
    )
    off = relative(true[:-1], true[1:]) - part.steps.motion
    own = (
        part.steps.jacobian
        @ np.linalg.inv(part.information[0] + np.diag(np.full(6, 1e-9)))
        @ part.steps.jacobian.transpose(0, 2, 1)
    )
    spread = part.steps.covariance + own
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off)
    assert (np.linalg.eigvalsh(part.steps.covariance) > 0.0).all()
    assert np.median(squared) < 8.0
    assert np.hypot(*off[:, :2].T).max() < 1.5


def test_nodes_are_solved_like_all_keyframes(sims: list[Simulated], parts: list[Condensed]) -> None:
    result, seen = solve_condensed(parts, MappingConfig(), SlamConfig())
    whole = solve(*(sim.drive for sim in sims))
    for number, sim in enumerate(sims):
        off, laid = pose_errors(result, sim.truth, number)
        off_whole, laid_whole = pose_errors(whole, sim.truth, number)
        assert np.quantile(laid, 0.95) < np.quantile(laid_whole, 0.95) + 0.15
        assert abs(np.median(off) - np.median(off_whole)) < 1.0
    assert result.summary.loops > 5
    # scans and landmarks came along with the poses
    views = seen[0].detections.views
    np.testing.assert_allclose(views.poses, result.references[0].at(views.stamp_s), atol=0.05)


def test_the_order_of_drives_changes_nothing(parts: list[Condensed]) -> None:
    one, _ = solve_condensed(parts, MappingConfig(), SlamConfig())
    two, _ = solve_condensed(parts[::-1], MappingConfig(), SlamConfig())
    for first, second in zip(one.references, two.references[::-1], strict=True):
        np.testing.assert_array_equal(first.poses, second.poses)
    assert [d.drive for d in two.summary.drives] == ["drive 1", "drive 0"]


def test_a_checkpoint_gives_back_the_same_and_nothing_of_another_key(
    parts: list[Condensed], tmp_path: Path
) -> None:
    path = tmp_path / f"{KEY}.npz"
    write_condensed(parts[0], KEY, path)
    again = read_condensed(path, KEY)
    assert again is not None
    np.testing.assert_array_equal(again.chain, parts[0].chain)
    np.testing.assert_array_equal(again.steps.covariance, parts[0].steps.covariance)
    np.testing.assert_array_equal(
        again.observed.landmarks.points_m, parts[0].observed.landmarks.points_m
    )
    assert again.residual_m == parts[0].residual_m
    assert 0.0 < again.residual_m < 0.5
    assert read_condensed(path, "1" * 32) is None
    path.write_bytes(path.read_bytes()[:-400])
    assert read_condensed(path, KEY) is None
    assert read_condensed(tmp_path / "none.npz", KEY) is None


def test_what_cannot_be_solved_together_is_named(parts: list[Condensed]) -> None:
    twin = replace(parts[0], name="drive 9")
    with pytest.raises(InputError, match=r"drive drive 9: its odometry is that of drive drive 0"):
        solve_condensed([parts[0], twin], MappingConfig(), SlamConfig())
    blind = replace(parts[1], fix_s=np.empty(0), fix_m=np.empty((0, 2)), hdop=np.empty(0))
    with pytest.raises(InputError, match="drive drive 1: it has no GNSS fix"):
        solve_condensed([parts[0], blind], MappingConfig(), SlamConfig())


def test_without_fixes_the_nodes_stand_in_a_local_frame(sims: list[Simulated]) -> None:
    part = condensed(replace(sims[0].drive, gnss=None), "taxi")
    result, _ = solve_condensed([part], MappingConfig(), SlamConfig())
    assert result.frame.kind == "local"
    assert result.frame.name == "taxi"
    _, laid = pose_errors(result, sims[0].truth)
    assert np.quantile(laid, 0.95) < 0.6


def test_where_a_drive_is_lost_its_nodes_are_found_by_patterns(parts: list[Condensed]) -> None:
    """The second drive is believed to be 60 m aside, and known to 40 m."""
    state = solve_condensed(parts, MappingConfig(), SlamConfig())[0]._state
    builder = CondensedBuilder(parts, MappingConfig(), SlamConfig(), parts[0].frame)
    submaps = builder.submaps(state)
    anchors = np.array([submap.anchor for submap in submaps])
    solved = state.solution.poses[anchors]
    second = np.array([submap.route for submap in submaps]) == 1
    believed = solved + np.where(second[:, np.newaxis], [0.0, 60.0, 0.0], 0.0)

    class Lost:
        def covariance(self, rows: Whole, _points: Whole) -> Floats:
            astray = np.repeat(rows >= len(parts[0].stamp_s), 3).astype(np.float64)
            sd = astray * np.tile([40.0, 40.0, 0.3], len(rows))
            alike = np.tile(np.arange(3), len(rows))
            return np.outer(sd, sd) * (alike[:, None] == alike) + 1e-4 * np.eye(len(sd))

    graph: Any = Lost()
    found = builder.find_loops(submaps, believed, anchors, graph, set())
    assert len(found.loops) >= 4
    for loop in found.loops:
        off = relative(solved[loop.first], solved[loop.second]) - loop.measured
        assert np.hypot(*off[:2]) < 1.0
