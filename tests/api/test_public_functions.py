"""The public functions agree with the commands, and refuse what they cannot use."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import polemap
from polemap.api import plausible
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.writers.folder import write_drive
from polemap.evaluation.run_metrics import run_metrics
from polemap.map.pole_map import PoleMap
from polemap.stereo.errors import StereoError
from polemap.stereo.rig import StereoRig
from polemap.tools import cli
from tests.localize.point_drives import street_drive

FEW = polemap.Settings(localize={"particles": 150})


@pytest.fixture(scope="module")
def street() -> tuple[Drive, PoleMap]:
    made = street_drive(2, duration_s=8.0)
    return made.drive, made.pole_map


@pytest.fixture(scope="module")
def on_disk(street: tuple[Drive, PoleMap], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folders drive and run, and map.gpkg."""
    place = tmp_path_factory.mktemp("street")
    write_drive(street[0], place / "drive")
    polemap.write_map(street[1], str(place / "map.gpkg"))
    words = f"localize {place}/drive --map {place}/map.gpkg --out {place}/run --seed 4"
    assert cli.run([*words.split(), "--set", "localize.particles=150"]) == cli.GOOD
    return place


def test_replay_gives_what_the_command_gives(on_disk: Path) -> None:
    drive = polemap.open_drive(str(on_disk / "drive"))
    pole_map = polemap.read_map(str(on_disk / "map.gpkg"), drive.frame)
    ticks: list[int] = []
    run = polemap.replay(drive, pole_map, FEW, seed=4, progress=ticks.append)
    assert sum(ticks) == len(drive.scans)
    ours, theirs = (polemap.evaluate(one, drive) for one in (run, on_disk / "run"))
    # the command's trajectories state no covariances
    assert theirs.nees_mean is None
    figures = [{**asdict(one), "nees_mean": 0.0} for one in (ours, theirs)]
    assert figures[0] == pytest.approx(figures[1], rel=1e-9)
    assert ours.nees_mean is not None
    assert ours.nees_mean > 0
    assert ours.position_rmse_m == pytest.approx(run_metrics(run, drive)["kf"]["position_rmse_m"])


def test_evaluate_takes_what_a_user_has(on_disk: Path) -> None:
    run, drive = on_disk / "run", on_disk / "drive"
    output = polemap.evaluate(run, drive)
    assert polemap.evaluate(run / "kf.tum", str(drive)) == output
    particles = polemap.evaluate(run, polemap.open_drive(drive), of="pf")
    assert particles == polemap.evaluate(run / "pf.tum", drive)
    assert particles.poses < output.poses
    itself = polemap.evaluate(run / "kf.tum", run / "kf.tum")
    assert itself.position_max_m == 0.0
    assert itself.poses_without_reference == 0


def test_evaluate_names_what_is_missing(
    on_disk: Path, street: tuple[Drive, PoleMap], tmp_path: Path
) -> None:
    run = on_disk / "run"
    with pytest.raises(InputError, match="no reference poses to evaluate against"):
        polemap.evaluate(run, replace(street[0], reference=None))
    with pytest.raises(InputError, match="no such trajectory"):
        polemap.evaluate(tmp_path / "none.tum", street[0])
    later = tmp_path / "later.tum"
    later.write_text("1e6 0 0 0 0 0 0 1\n1000001 1 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match="are both of the same drive"):
        polemap.evaluate(later, street[0])
    many = tmp_path / "many"
    (many / "000").mkdir(parents=True)
    (many / "000" / "kf.tum").write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"a folder of runs; evaluate one of them, such as .*000"):
        polemap.evaluate(many, street[0])


def test_a_map_from_poles_that_lie_beside_the_drive(street: tuple[Drive, PoleMap]) -> None:
    drive, truth = street
    settings = polemap.Settings(polemap={"mapping": {"observations_min": 4}})
    built = polemap.build_map(drive, settings)
    assert len(built) > 3
    nearest = np.linalg.norm(built.points_m[:, None] - truth.points_m[None], axis=2).min(axis=1)
    assert np.median(nearest) < 0.3
    again = polemap.build_map([drive], settings, update=built)
    assert set(built.ids) & set(again.ids)
    with pytest.raises(InputError, match="at least one drive"):
        polemap.build_map([])
    with pytest.raises(InputError, match="neither images nor poles"):
        polemap.build_map(replace(drive, scans=()))


def _in_kmh(drive: Drive) -> Drive:
    return replace(
        drive, odometry=replace(drive.odometry, speed_mps=3.6 * drive.odometry.speed_mps)
    )


@pytest.mark.filterwarnings("error")
def test_what_cannot_be_right_is_refused_unless_forced(street: tuple[Drive, PoleMap]) -> None:
    drive, pole_map = _in_kmh(street[0]), street[1]
    with pytest.raises(polemap.PolemapError, match=r"times that of .*m/s \(force=True goes on"):
        polemap.replay(drive, pole_map, FEW)
    with pytest.raises(polemap.PolemapError, match="force=True goes on"):
        polemap.build_map(drive)
    with pytest.warns(UserWarning, match="times that of") as warned:
        polemap.replay(drive, pole_map, FEW, force=True)
    assert warned[0].filename == __file__
    assert all("\n" not in str(one.message) for one in warned)
    polemap.replay(drive, pole_map, FEW, force=True, seed=1)  # said once


@pytest.mark.filterwarnings("error")
def test_what_is_doubtful_is_warned_of_once(
    street: tuple[Drive, PoleMap], monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = street[0]
    late = replace(drive.odometry, arrival_s=drive.odometry.stamp_s + 2.0)
    doubtful = replace(drive, odometry=late)
    looked: list[Drive] = []
    find = plausible.find
    monkeypatch.setattr(plausible, "find", lambda d, m: looked.append(d) or find(d, m))
    with pytest.warns(UserWarning, match="rows arrive 2 s after their stamp"):
        polemap.replay(doubtful, street[1], FEW)
    polemap.replay(doubtful, street[1], FEW, seed=1)
    assert len(looked) == 1


def test_live_gives_poses(street: tuple[Drive, PoleMap]) -> None:
    drive, pole_map = street
    localizer = polemap.Localizer(pole_map, drive, FEW, seed=4)
    poses = []
    for sample in drive.samples():
        localizer.add_sample(sample)
        poses.append(localizer.pose_at(sample.arrival_s))
    known = [pose for pose in poses if pose is not None]
    assert len(known) > 50
    other = replace(pole_map, frame=EarthFrame("local", name="elsewhere"))
    with pytest.raises(FrameError, match=r"read the map in the car's frame"):
        polemap.Localizer(other, drive)


def test_perception_needs_a_camera_and_fitting_images(street: tuple[Drive, PoleMap]) -> None:
    with pytest.raises(InputError, match="it has no camera"):
        polemap.Perception(replace(street[0], rig=None))
    perception = polemap.Perception(StereoRig(64, 48, 60.0, 32.0, 24.0, 0.3))
    with pytest.raises(StereoError):
        perception.poles(np.zeros((48, 64), np.uint8), np.zeros((48, 32), np.uint8))
    with pytest.raises(InputError, match=r"left.png: .*cannot be read"):
        perception.poles("left.png", "right.png")


def test_an_empty_pair_has_an_empty_table(tmp_path: Path) -> None:
    rig = StereoRig(160, 96, 150.0, 80.0, 48.0, 0.3)
    grey = np.full((96, 160), 90, np.uint8)
    found = polemap.Perception(rig).poles(grey, grey)
    assert len(found.table) == 0
    assert {"x_m", "y_m", "width_m", "probability"} <= set(found.table.columns)
    assert found.picture().ndim == 3


def test_every_kind_of_input_error_has_one_base() -> None:
    for kind in (InputError, FrameError, StereoError):
        assert issubclass(kind, polemap.PolemapError)


def test_a_folder_with_a_drive_yaml_describes_a_car(on_disk: Path, tmp_path: Path) -> None:
    (tmp_path / "car").mkdir()
    description = (on_disk / "drive" / "drive.yaml").read_text(encoding="utf-8")
    (tmp_path / "car" / "drive.yaml").write_text(description, encoding="utf-8")
    car = polemap.open_drive(tmp_path / "car")
    localizer = polemap.Localizer(polemap.read_map(on_disk / "map.gpkg", car.frame), car, FEW)
    assert localizer.pose_at(0.0) is None
    for sample in polemap.open_drive(on_disk / "drive").samples():
        localizer.add_sample(sample)
    assert localizer.pose_at(sample.arrival_s) is not None
