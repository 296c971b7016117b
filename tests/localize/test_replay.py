import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.tum import read_tum
from polemap.evaluation.run_metrics import landmarks_by_kind, run_metrics
from polemap.localize.config import LocalizeConfig
from polemap.localize.io import CORNER_COLUMNS, HEALTH_COLUMNS, write_run
from polemap.localize.particle_filter.estimate import KindHealth
from polemap.localize.replay import replay
from polemap.simulate.points.drive import FRAME
from tests.localize.point_drives import street_drive

CONFIG = LocalizeConfig(particles=300)


@pytest.fixture(scope="module")
def street():
    return street_drive(1)


@pytest.fixture(scope="module")
def run(street):
    return replay(street.drive, street.pole_map, street.scans, CONFIG, seed=5)


def test_the_output_stands_at_every_exact_tick_without_a_gap(run):
    ticks = np.round(run.kf.stamp_s * 100).astype(int)
    assert np.array_equal(run.kf.stamp_s, ticks / 100)
    assert np.array_equal(np.diff(ticks), np.ones(len(ticks) - 1))
    assert ticks[-1] == int(np.floor(max(19.98, 19.9 + 0.03) * 100))


def test_it_localizes_and_says_how_well(run, street):
    late = run.kf.stamp_s > 8.0
    true = street.motion.at(run.kf.stamp_s[late])[:, :2]
    error = np.hypot(*(run.kf.poses[late, :2] - true).T)
    assert np.median(error) < 0.15
    metrics = run_metrics(run, street.drive)
    for name in ("pf", "kf"):
        for figure in (
            "lateral_rmse_m",
            "longitudinal_rmse_m",
            "position_rmse_m",
            "position_median_m",
            "position_p95_m",
            "yaw_rmse_rad",
            "nees_mean",
        ):
            assert metrics[name][figure] >= 0.0
    for count in ("reinitializations", "exploration_events", "gate_rejections", "late_dropped"):
        assert metrics[count] >= 0
    assert metrics["notes"] == ["made of points"]
    assert metrics["input_problems"] == {"odometry: bad rows": 2}
    assert "timing_ms" not in metrics


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(run, street):
    again = replay(street.drive, street.pole_map, street.scans, CONFIG, seed=5)
    assert np.array_equal(again.kf.poses, run.kf.poses)
    assert np.array_equal(again.pf.poses, run.pf.poses)
    assert again.counts == run.counts
    other = replay(street.drive, street.pole_map, street.scans, CONFIG, seed=6)
    assert not np.array_equal(other.pf.poses, run.pf.poses)


def test_a_pose_is_taken_when_its_scan_has_arrived_and_been_processed(run):
    delay = CONFIG.output.processing_delay_s
    for update in run.updates:
        assert update.taken_s == pytest.approx(update.estimate.stamp_s + 0.03 + delay)


def test_the_output_knows_nothing_of_what_has_not_arrived(street, run):
    """What comes after a moment does not change the output up to it."""
    cut = 12.0
    odometry = street.drive.odometry
    drive = replace(street.drive, odometry=odometry.take(odometry.arrival_s <= cut))
    scans = [scan for scan in street.scans if scan.arrival_s <= cut]
    part = replay(drive, street.pole_map, scans, CONFIG, seed=5)
    rows = min(np.searchsorted(run.kf.stamp_s, cut - 0.05), len(part.kf.stamp_s))
    assert rows > 500
    assert np.array_equal(part.kf.poses[:rows], run.kf.poses[:rows])


def test_poles_beat_dead_reckoning(street, run):
    without = replay(street.drive, None, (), CONFIG, seed=5)
    alone, aided = (run_metrics(one, street.drive) for one in (without, run))
    assert "pf" not in alone
    assert len(without.pf.stamp_s) == 0
    assert alone["kf"]["position_median_m"] > aided["kf"]["position_median_m"]


def test_timings_come_from_the_clock_that_is_given(street, tmp_path):
    ticking = iter(range(10**9))
    scans = street.scans[20:30]
    run = replay(
        street.drive,
        street.pole_map,
        scans,
        CONFIG,
        seed=5,
        clock=lambda: next(ticking) * 0.001,
    )
    metrics = run_metrics(run, street.drive)
    timing = metrics["timing_ms"]
    assert timing["particle_filter"]["median"] == pytest.approx(1.0)
    assert timing["output_tick"]["calls"] > 100
    assert metrics["replay_s"] > 0
    looked = {"disparity": {scan.stamp_s: 0.02 for scan in scans[1:]}}
    write_run(tmp_path, run, metrics, {}, looked)
    header, *rows = (tmp_path / "timing.csv").read_text().splitlines()
    assert header == "stamp_s,disparity_ms,particle_filter_ms,output_pose_ms"
    assert len(rows) == len(run.updates)
    cells = [row.split(",") for row in rows]
    assert [float(row[0]) for row in cells] == sorted(u.estimate.stamp_s for u in run.updates)
    first = scans[0].stamp_s
    assert {row[1] for row in cells if float(row[0]) != first} == {"20.0000"}
    assert {row[1] for row in cells if float(row[0]) == first} <= {""}
    assert {row[2] for row in cells} == {"1.0000"}


def test_a_map_of_another_frame_is_refused(street):
    other = replace(street.pole_map, frame=EarthFrame("utm", epsg=32633))
    with pytest.raises(FrameError, match=r"EPSG:32633.*local frame 'points'"):
        replay(street.drive, other, street.scans, CONFIG, seed=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"odometry": None}, "it has no odometry"),
        ({"scans": ()}, "neither images nor poles.csv; --without-poles"),
        ({"map": "empty"}, "the map holds no poles"),
        ({"map": None, "gnss": None}, "without poles it needs GNSS"),
    ],
)
def test_what_cannot_be_localized_is_refused(street, change, message):
    pole_map, scans = street.pole_map, change.get("scans", street.scans)
    if "map" in change:
        pole_map = None
        if change["map"] == "empty":
            none = slice(0, 0)
            full = street.pole_map
            pole_map = type(full)(
                frame=FRAME,
                ids=full.ids[none],
                points_m=full.points_m[none],
                covariance_m2=full.covariance_m2[none],
                width_m=full.width_m[none],
                height_m=full.height_m[none],
                observations=full.observations[none],
                drives=full.drives[none],
                existence=full.existence[none],
            )
    streams = {key: value for key, value in change.items() if key in ("odometry", "gnss")}
    with pytest.raises(InputError, match=message):
        replay(replace(street.drive, **streams), pole_map, scans, CONFIG, seed=0)


def test_a_run_folder_holds_what_the_contract_says(run, tmp_path):
    write_run(tmp_path, run, {"updates": 7}, {"seed": 5, "polemap_version": "x"})
    assert {path.name for path in tmp_path.iterdir()} == {
        "pf.tum",
        "kf.tum",
        "health.csv",
        "output.csv",
        "metrics.json",
        "config.yaml",
    }
    written = read_tum(tmp_path / "kf.tum")
    assert np.array_equal(written.stamp_s, run.kf.stamp_s)
    assert np.array_equal(written.poses[:, :2], run.kf.poses[:, :2])
    assert np.allclose(written.poses[:, 2], run.kf.poses[:, 2], atol=1e-15)
    header, *rows = (tmp_path / "health.csv").read_text().splitlines()
    assert header == ",".join(HEALTH_COLUMNS)
    assert len(rows) == len(run.updates)
    assert all(row.count(",") == header.count(",") for row in rows)
    place = HEALTH_COLUMNS.index("nis")
    told = [row.split(",")[place] for row in rows]
    known = [u.nis for u in sorted(run.updates, key=lambda u: u.estimate.stamp_s)]
    assert [float(cell or "nan") for cell in told] == pytest.approx(known, nan_ok=True)
    assert sum(cell != "" for cell in told) > len(rows) / 2
    assert json.loads((tmp_path / "metrics.json").read_text())["updates"] == 7
    assert yaml.safe_load((tmp_path / "config.yaml").read_text())["seed"] == 5


def test_numbers_that_are_not_finite_become_null(run, tmp_path):
    odd = {"a": float("nan"), "b": {"c": [np.float64(1.5), np.inf]}}
    write_run(tmp_path, run, odd, {})
    assert json.loads((tmp_path / "metrics.json").read_text()) == {
        "a": None,
        "b": {"c": [1.5, None]},
    }


def test_what_each_kind_has_shown_is_counted_and_told(run, tmp_path):
    """As if every second pole were a corner that was not believed in the second half."""
    updates = []
    for number, update in enumerate(run.updates):
        late = number >= len(run.updates) // 2
        kinds = (KindHealth(0, 4, 3, False, 0.03), KindHealth(1, 2, 1 - late, late, 0.04))
        health = replace(update.estimate.health, by_kind=kinds)
        updates.append(replace(update, estimate=replace(update.estimate, health=health)))
    n, late = len(updates), len(updates) - len(updates) // 2
    told = landmarks_by_kind(updates, {"pf_corners_suspended": 1})
    assert list(told) == ["pole", "corner"]
    assert (told["pole"]["seen"], told["pole"]["matched"]) == (4 * n, 3 * n)
    assert told["pole"]["residual_rms_m"] == pytest.approx(0.1)
    assert (told["corner"]["matched"], told["corner"]["suspensions"]) == (n - late, 1)
    assert told["corner"]["suspended_share"] == pytest.approx(late / n)
    write_run(tmp_path, replace(run, updates=tuple(updates)), {}, {})
    header, *rows = (tmp_path / "health.csv").read_text().splitlines()
    assert header == ",".join((*HEALTH_COLUMNS, *CORNER_COLUMNS))
    assert [row.rsplit(",", 3)[1:] for row in (rows[0], rows[-1])] == [
        ["1", "2", "0"],
        ["0", "2", "1"],
    ]


def test_poles_of_a_run_are_counted(run, street):
    told = run_metrics(run, street.drive, street.pole_map)["landmarks_by_kind"]
    assert list(told) == ["pole"]
    assert told["pole"]["in_map"] == len(street.pole_map)
    matched = sum(update.estimate.health.matched for update in run.updates)
    assert told["pole"]["matched"] == matched > 0
    assert 0.0 < told["pole"]["residual_rms_m"] < 0.5
