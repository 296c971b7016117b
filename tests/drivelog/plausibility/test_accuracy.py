"""Stated accuracies, the antenna and the wheelbase against what the motion shows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.plausibility.jitter import jitter_m, without_jitter
from polemap.drivelog.plausibility.steering import find_wheelbase_m, wheelbase_findings
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tables import read_table
from polemap.drivelog.writers.folder import write_drive
from tests.drivelog.plausibility.made import clean_drive, with_gnss, with_reference
from tests.drivelog.plausibility.test_streams import found

COLUMNS = ("stamp_s", "road_wheel_angle_rad", "yaw_rate_radps", "vx_mps")


@pytest.fixture(scope="module")
def clean() -> Drive:
    return clean_drive(0, duration_s=160.0)


def _scattered(drive: Drive, sd_m: float, hdop: float) -> Drive:
    gnss, rng = drive.gnss, np.random.default_rng(2)
    east, north = (sd_m * rng.standard_normal(len(gnss)) for _ in range(2))
    return with_gnss(
        drive,
        east_m=gnss.east_m + east,
        north_m=gnss.north_m + north,
        hdop=np.full(len(gnss), hdop),
    )


def _variances(drive: Drive, factor: float) -> Drive:
    scans = tuple(replace(s, covariance_m2=factor * s.covariance_m2) for s in drive.scans)
    return replace(drive, scans=scans)


@pytest.mark.parametrize("alone", [False, True])
def test_fixes_that_state_centimetres_and_scatter_by_metres(clean: Drive, alone: bool) -> None:
    drive = _scattered(replace(clean, reference=None) if alone else clean, 2.0, 0.008)
    finding = found(drive, "gnss_accuracy", "gnss.csv")
    assert "0.02 m, which they state" in finding.expected
    assert ("scatter by" if alone else "are off by") in finding.value
    honest = _scattered(replace(clean, reference=None) if alone else clean, 2.0, 1.0)
    assert check_drive(honest) == []


def test_fixes_in_another_place_are_no_matter_of_accuracy(clean: Drive) -> None:
    moved = with_gnss(clean, east_m=clean.gnss.east_m + 3000.0)
    assert [f.kind for f in check_drive(moved)] == ["gnss_reference"]


def test_fixes_of_centimetres_that_say_so(clean: Drive) -> None:
    poses = clean.reference.at(clean.gnss.stamp_s, max_gap_s=1.0)
    exact = with_gnss(clean, east_m=poses[:, 0], north_m=poses[:, 1])
    assert check_drive(_scattered(exact, 0.02, 0.008)) == []


def test_a_small_dilution_is_written_as_it_is(tmp_path: Path, clean: Drive) -> None:
    """Two decimals made 0 of it, which was read as not known: a receiver a hundred times worse."""
    exact = replace(with_gnss(clean, hdop=np.full(len(clean.gnss), 0.004)), scans=())
    write_drive(exact, tmp_path / "drive")
    assert open_drive(tmp_path / "drive").gnss.hdop[0] == pytest.approx(0.004)


@pytest.mark.parametrize("alone", [False, True])
def test_variances_of_poles_far_too_small_or_large(clean: Drive, alone: bool) -> None:
    drive = replace(clean, reference=None) if alone else clean
    assert "smaller" in found(_variances(drive, 1e-4), "pole_variance", "poles.csv").value
    assert "larger" in found(_variances(drive, 400.0), "pole_variance", "poles.csv").value
    for factor in (0.25, 4.0):
        assert check_drive(_variances(drive, factor)) == []


def test_a_reference_that_scatters_more_than_it_states(clean: Drive) -> None:
    rng = np.random.default_rng(3)
    poses = clean.reference.poses.copy()
    poses[:, :2] += 0.5 * rng.standard_normal((len(poses), 2))
    noisy = with_reference(clean, poses=poses)
    assert [f.kind for f in check_drive(noisy)] == ["reference_accuracy"]
    honest = with_reference(noisy, sd_m=np.full(len(poses), 0.5))
    assert check_drive(honest) == []
    assert jitter_m(noisy.reference) == pytest.approx(0.5, abs=0.05)
    assert jitter_m(without_jitter(noisy.reference)) == 0.0
    assert without_jitter(clean.reference) is clean.reference


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("antenna", [(-4.5, 0.0), (0.0, 3.0)])
def test_an_antenna_metres_off(clean: Drive, antenna: tuple[float, float], alone: bool) -> None:
    """Stated there, while the fixes are those of the rear axle."""
    drive = replace(clean, gnss_antenna_m=np.array(antenna))
    finding = found(replace(drive, reference=None) if alone else drive, "gnss_antenna", "gnss.csv")
    side = "ahead of" if antenna[0] else "right of"
    assert f"m {side} the stated antenna" in finding.value


def _signals(folder: Path, wheelbase_m: float, steering_ratio: float = 1.0) -> Path:
    """A log of bends and straights, steered through a wheelbase with some understeer."""
    t = np.arange(0.0, 60.0, 0.02)
    speed = 7.0 + 2.0 * np.sin(t / 9.0)
    rate = 0.3 * np.sin(t / 4.0)
    angle = wheelbase_m * rate / speed + 0.003 * speed * rate + 0.01 * np.gradient(rate, t)
    angle += 0.002 * np.random.default_rng(0).standard_normal(len(t))
    rows = np.stack([t, steering_ratio * angle, rate, speed], axis=1)
    path = folder / "signals.csv"
    np.savetxt(path, rows, fmt="%.7f", delimiter=",", header=",".join(COLUMNS), comments="")
    return path


def test_a_wheelbase_that_the_steering_contradicts(tmp_path: Path, clean: Drive) -> None:
    drive = replace(clean, path=tmp_path)
    assert wheelbase_findings(drive) == []
    assert find_wheelbase_m(read_table(_signals(tmp_path, 2.7), COLUMNS)) == pytest.approx(
        2.7, abs=0.1
    )
    assert check_drive(drive) == []
    halved = found(replace(drive, wheelbase_m=1.35), "wheelbase", "drive.yaml")
    assert "wheelbase_m is 1.35" in halved.value
    assert "signals.csv show 2.7" in halved.value


def test_a_log_that_shows_no_wheelbase_says_nothing_of_it(tmp_path: Path, clean: Drive) -> None:
    drive = replace(clean, path=tmp_path)
    # the angle of the steering wheel is another mistake
    _signals(tmp_path, 2.7, steering_ratio=16.0)
    assert wheelbase_findings(drive) == []
    table = read_table(_signals(tmp_path, 2.7), COLUMNS)
    shuffle = np.random.default_rng(1).permutation
    shuffled = {**table.columns, "road_wheel_angle_rad": shuffle(table["road_wheel_angle_rad"])}
    assert find_wheelbase_m(replace(table, columns=shuffled)) is None
    assert find_wheelbase_m(table.keep(table["stamp_s"] < 0.5, "late")) is None
    (tmp_path / "signals.csv").write_text("stamp_s,note\n1,x\n")
    assert wheelbase_findings(drive) == []
