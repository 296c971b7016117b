"""Trajectories written for other programs, read back by those where they are installed."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import geopandas
import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError, FrameError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.tum import read_tum
from polemap.drivelog.writers.trajectory import kitti_poses, write_trajectory
from polemap.vehicle.trajectory import Trajectory

UTM = EarthFrame("utm", 32632)
LOCAL = EarthFrame("local", name="yard")
GPX = "{http://www.topografix.com/GPX/1/1}"


def circle(start_s: float = 1.7e9, count: int = 50) -> Trajectory:
    yaw = np.linspace(-1.0, 2.0, count)
    poses = np.column_stack([458000.0 + 20 * np.sin(yaw), 5.43e6 - 20 * np.cos(yaw), yaw])
    return Trajectory(start_s + 0.1 * np.arange(count), poses)


def test_tum_and_csv_lose_nothing(tmp_path: Path) -> None:
    track = circle()
    known = {"healthy": np.arange(50.0) % 2, "flag": ["started", *[""] * 49]}
    write_trajectory(tmp_path / "t.tum", track, LOCAL, "t")
    back = read_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(back.stamp_s, track.stamp_s)
    np.testing.assert_allclose(back.poses, track.poses, rtol=0, atol=1e-9)
    write_trajectory(tmp_path / "t.csv", track, UTM, "t", known)
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["east_m"]) for row in rows] == track.poses[:, 0].tolist()
    assert [row["healthy"] for row in rows[:2]] == ["0", "1"]
    assert [row["flag"] for row in rows[:2]] == ["started", ""]
    place = geographic_from_grid(UTM, track.poses[:1, :2])[0]
    assert (float(rows[0]["latitude_deg"]), float(rows[0]["longitude_deg"])) == tuple(place)


def test_kitti_poses_start_at_the_identity_in_camera_axes(tmp_path: Path) -> None:
    straight = np.zeros((3, 3))
    straight[:, :2] = [[5.0, 7.0], [5.0, 8.0], [5.0, 9.0]]
    straight[:, 2] = np.pi / 2  # north; the last one turned 0.1 rad to the left
    straight[2, 2] += 0.1
    track = Trajectory(np.arange(3.0), straight)
    notes = write_trajectory(tmp_path / "t.kitti", track, LOCAL, "t")
    assert "no stamps" in notes[0]
    table = np.loadtxt(tmp_path / "t.kitti").reshape(-1, 3, 4)
    np.testing.assert_allclose(table[0], np.eye(4)[:3], atol=1e-12)
    np.testing.assert_allclose(table[1][:, 3], [0.0, 0.0, 1.0], atol=1e-12)  # forward is z
    # to the left is a turn of the forward axis towards -x
    assert table[2][0, 2] == pytest.approx(-np.sin(0.1))
    np.testing.assert_allclose(table, kitti_poses(track), atol=1e-11)


def test_gpx_and_geojson_stand_where_the_car_was(tmp_path: Path) -> None:
    track = circle()
    places = geographic_from_grid(UTM, track.poses[:, :2])
    notes = write_trajectory(tmp_path / "t.gpx", track, UTM, "lap <2> & more")
    assert notes == []
    root = ElementTree.parse(tmp_path / "t.gpx").getroot()
    points = root.findall(f".//{GPX}trkpt")
    found = [(float(p.attrib["lat"]), float(p.attrib["lon"])) for p in points]
    np.testing.assert_allclose(found, places, atol=1e-9)
    assert points[0].findtext(f"{GPX}time") == "2023-11-14T22:13:20.000Z"
    assert root.findtext(f".//{GPX}name") == "lap <2> & more"

    healthy = np.ones(50)
    healthy[3] = np.nan
    write_trajectory(tmp_path / "t.geojson", track, UTM, "t", {"healthy": healthy})
    frame = geopandas.read_file(tmp_path / "t.geojson")
    assert frame.crs.to_epsg() == 4326
    assert list(frame.geometry.geom_type[:2]) == ["LineString", "Point"]
    back = frame.to_crs(32632).geometry[1:]
    np.testing.assert_allclose(back.x, track.poses[:, 0], atol=1e-3)
    np.testing.assert_allclose(back.y, track.poses[:, 1], atol=1e-3)
    assert np.isnan(frame["healthy"][4])
    assert json.loads((tmp_path / "t.geojson").read_text())["polemap"]["frame"]["epsg"] == 32632


def test_one_pose_is_no_line(tmp_path: Path) -> None:
    write_trajectory(tmp_path / "t.geojson", circle(count=1), UTM, "t")
    assert list(geopandas.read_file(tmp_path / "t.geojson").geometry.geom_type) == ["Point"] * 2


def test_stamps_from_a_switched_on_computer_are_no_dates(tmp_path: Path) -> None:
    notes = write_trajectory(tmp_path / "t.gpx", circle(start_s=12.0), UTM, "t")
    assert "no times" in notes[0]
    assert "<time>" not in (tmp_path / "t.gpx").read_text()


@pytest.mark.parametrize("ending", [".gpx", ".geojson"])
def test_a_local_frame_has_no_latitude(ending: str, tmp_path: Path) -> None:
    with pytest.raises(FrameError, match=r"not tied to the earth; write \.tum"):
        write_trajectory(tmp_path / f"t{ending}", circle(), LOCAL, "t")
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_trajectory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"ends in \.tum"):
        write_trajectory(tmp_path / "t.txt", circle(), LOCAL, "t")
    with pytest.raises(ConfigError, match="holds no pose"):
        write_trajectory(tmp_path / "t.tum", circle(count=0), LOCAL, "t")


@pytest.mark.parametrize(("kind", "ending"), [("tum", "tum"), ("kitti", "kitti")])
def test_evo_reads_them(kind: str, ending: str, tmp_path: Path) -> None:
    """Files are exchanged only; evo is a program of its own, looked for on PATH."""
    evo = shutil.which("evo_traj")
    if evo is None:
        pytest.skip("evo is not installed")
    track = circle()
    write_trajectory(tmp_path / f"t.{ending}", track, LOCAL, "t")
    said = subprocess.run(
        [evo, kind, str(tmp_path / f"t.{ending}")], capture_output=True, text=True, check=True
    ).stdout
    assert "50 poses" in said
    assert f"{track.travelled_m()[-1]:.3f}m path length" in said
