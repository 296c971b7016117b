"""No command costs anybody a file: not its inputs, not the user's own, not a finished result."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import cv2
import numpy as np
import pyogrio
import pytest

from polemap.drivelog.atomic import reserved
from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import write_map
from polemap.tools import cli
from tests.localize.point_drives import street_drive

FEW = ["--set", "localize.particles=150", "--set", "localize.output.rate_hz=20"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a drive, a map, a run, a settings file and a signal log."""
    street = street_drive(2, duration_s=8.0)
    folder = tmp_path_factory.mktemp("made")
    write_drive(street.drive, folder / "in" / "drive")
    write_map(street.pole_map, folder / "in" / "map.gpkg")
    (folder / "in" / "settings.yaml").write_text("localize: {particles: 150}\n")
    (folder / "in" / "log.csv").write_text("stamp_s,vx_mps\n" + "0,1\n1,1\n")
    words = ["localize", "in/drive", "--map", "in/map.gpkg", "--out", "in/run", *FEW]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert cli.run(words) == cli.GOOD
    return folder


@pytest.fixture
def place(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


LOCALIZE = ["localize", "in/drive", "--map", "in/map.gpkg", *FEW]


@pytest.mark.parametrize(
    "words",
    [
        [*LOCALIZE, "--out", "in/drive"],
        [*LOCALIZE, "--out", "in"],
        [*LOCALIZE, "--out", "."],
        [*LOCALIZE, "--out", "in/drive/run"],
        [*LOCALIZE, "--out", "in/map.gpkg"],
        [*LOCALIZE, "--out", "cache", "--cache", "cache"],
        [*LOCALIZE, "--out", "in/drive/../run", "--config", "in/run/config.yaml"],
        ["detect", "in/drive", "--out", "in/drive"],
        ["detect", "in/drive", "--out", "in"],
        ["map", "in/drive", "--out", "in/drive/map.gpkg"],
        ["map", "in/drive", "--out", "a.gpkg", "--update", "in/map.gpkg", "--picture", "a.gpkg"],
        ["map", "in/drive", "--out", "a.gpkg", "--localizability", "in/drive/a.geojson"],
        ["map", "--convert", "in/map.gpkg", "--out", "in/map.gpkg"],
        ["map", "--diff", "in/map.gpkg", "in/map.gpkg", "--out", "in/map.gpkg"],
        ["report", "in/run", "--out", "in/run"],
        ["report", "in/run", "--out", "in"],
        ["report", "in/run", "--out", "in/run/report"],
        ["report", "in/run", "--out", "in/drive"],
        ["report", "in/run", "--out", "out", "--add", "mine=out/mine.tum"],
        ["estimate", "in/log.csv", "--vehicle", "coms", "--out", "in/log.csv"],
        ["train", "in/drive=in/map.gpkg", "--out", "in/map.gpkg"],
        ["train", "in/drive=in/map.gpkg", "--out", "in/drive/model.json"],
        ["simulate", "in/settings.yaml", "--out", "in"],
        ["simulate", "park_loop", "--out", "in/run"],
        ["simulate", "park_loop", "--out", "in"],
        ["study", "W14", "--out", "in/run"],
        ["demo", "--out", "in"],
        ["calibrate", "in/drive", "--out", "in/drive/drive.yaml"],
        ["calibrate", "in/drive", "--out", "in/settings.yaml"],
        ["calibrate", "in/drive", "--pictures", "in"],
        ["odometry", "in/drive", "--out", "in/drive/a.tum"],
        ["odometry", "in/drive", "--out", "a.tum", "--csv", "in/drive/odometry.csv"],
        ["odometry", "in/drive", "--out", "in/map.gpkg"],
        ["odometry", "in/drive", "--out", "a.tum", "--csv", "in/map.gpkg"],
        ["odometry", "in/other", "--out", "in/run/kf.tum"],
        ["odometry", "in/other", "--out", "mine.txt"],
        ["convert", "in/run", "--out", "in/drive/odometry.csv"],
        ["convert", "in/drive", "--out", "in/run/kf.tum"],
        ["convert", "in/drive", "--to", "tum", "--out", "in/map.gpkg"],
        ["estimate", "in/log.csv", "--vehicle", "coms", "--out", "in/map.gpkg"],
        ["estimate", "in/log.csv", "--vehicle", "coms", "--identify", "0:1", "--out", "mine.txt"],
        ["lanes", "in/drive", "--out", "in/settings.yaml"],
        ["where", "in/drive", "--map", "in/map.gpkg", "--picture", "in/drive/where.png"],
        ["convert", "in/drive", "--to", "kitti", "--out", "in/drive"],
        ["convert", "in/drive", "--to", "mcap", "--out", "in/drive/a.mcap"],
        ["convert", "in/run", "--out", "in/run/a.tum"],
        ["view", "in/run", "--out", "in/run/a.mcap"],
        ["new", "in/drive"],
        ["disparity", "a.png", "b.png", "--out", "a.png"],
        ["disparity", "a.png", "b.png", "--out", "d.png", "--right-out", "d.png"],
        ["disparity", "a.png", "b.png", "--out", "pipe.png"],
    ],
)
def test_a_result_never_replaces_an_input_or_the_users_own(
    words: list[str], place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "cache").mkdir()
    (place / "cache" / "scans.npz").write_text("hours of work")
    (place / "out").mkdir()
    (place / "out" / "mine.tum").write_text("0 0 0 0 0 0 0 1\n")
    (place / "a.png").write_text("a picture")
    (place / "b.png").write_text("a picture")
    (place / "mine.txt").write_text("a thesis")
    (place / "pipe.png").symlink_to("/dev/null")
    before = contents(place)
    assert cli.run(words) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    remedies = (
        "choose",
        "give each its own",
        "name a file or folder",
        "is a file, a folder is",
        "give another name",
        "choose another name",
        "name another, or delete it",
    )
    assert any(remedy in error for remedy in remedies)
    assert contents(place) == before


@pytest.mark.parametrize("layer", ["parcels", None])
@pytest.mark.parametrize(
    "words",
    [
        ["map", "in/drive", "--out", "a.gpkg"],
        ["map", "in/drive", "--update", "a.gpkg", "--out", "a.gpkg"],
        ["map", "--convert", "in/map.gpkg", "--out", "a.gpkg"],
        ["map", "--diff", "in/map.gpkg", "in/map.gpkg", "--out", "a.gpkg"],
        [*LOCALIZE, "--out", "run", "--learn", "a.gpkg"],
    ],
)
def test_a_geopackage_with_layers_of_somebody_is_kept(
    words: list[str], layer: str | None, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A GIS puts new layers into the file that is open; None is a file of something else."""
    target = place / "a.gpkg"
    if layer is None:
        target.write_text("years of work")
    else:
        shutil.copy(place / "in" / "map.gpkg", target)
        poles = pyogrio.read_dataframe(target, layer="poles").iloc[:1]
        pyogrio.write_dataframe(poles, target, layer=layer, driver="GPKG", append=True)
    before = contents(place)
    assert cli.run(words) == cli.USER_ERROR
    error = capsys.readouterr().err
    if layer is not None:
        assert "holds the layer 'parcels', which polemap did not write" in error
    elif "--update" not in words:
        assert "is no GeoPackage that can be read" in error
    assert error.splitlines()[-1].startswith("polemap: ")
    assert contents(place) == before


_FEW_SEEN = ["--set", "polemap.mapping.observations_min=2"]
_MAP = ["map", "in/drive", "--out", "a.gpkg", *_FEW_SEEN]


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["map", "in/drive", "--out", "a.geojson", *_FEW_SEEN], "a.geojson"),
        (["map", "in/drive", "--out", "a.parquet", *_FEW_SEEN], "a.parquet"),
        (["map", "--convert", "in/map.gpkg", "--out", "a.geojson"], "a.geojson"),
        (["map", "--convert", "in/map.gpkg", "--out", "a.parquet"], "a.parquet"),
        (["map", "--diff", "in/map.gpkg", "in/map.gpkg", "--out", "a.geojson"], "a.geojson"),
        ([*_MAP, "--picture", "a.png"], "a.png"),
        ([*_MAP, "--picture", "a.svg"], "a.svg"),
        ([*_MAP, "--picture", "a.pdf"], "a.pdf"),
        (["disparity", "l.png", "r.png", "--out", "a.png"], "a.png"),
    ],
)
def test_only_a_file_that_polemap_wrote_is_replaced(
    words: list[str], name: str, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = np.random.default_rng(1).integers(0, 255, (64, 160), dtype=np.uint8)
    cv2.imwrite(str(place / "l.png"), picture)
    cv2.imwrite(str(place / "r.png"), np.roll(picture, -5, axis=1))
    theirs = place / name
    if name.endswith(".png"):
        cv2.imwrite(str(theirs), picture)
    else:
        theirs.write_text('{"type": "FeatureCollection", "features": [], "by": "somebody"}')
    before = contents(place)
    assert cli.run(words) == cli.USER_ERROR
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"polemap: {name}: is there already and was not written by polemap")
    assert contents(place) == before
    theirs.unlink()
    for _ in range(2):
        assert cli.run(words) == cli.GOOD, capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        [*LOCALIZE, "--out", "run", "--learn", "loop"],
        ["view", "loop"],
        ["view", "in/run", "--drive", "loop", "--out", "a.rrd"],
        ["convert", "in/run", "--drive", "loop", "--out", "a.mcap"],
        ["map", "in/drive", "--topics", "loop", "--out", "a.gpkg"],
        ["new", "loop"],
    ],
)
def test_links_in_a_circle_are_told_in_one_line(
    words: list[str], place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "loop").symlink_to("loop")
    assert cli.run(words) == cli.USER_ERROR
    assert capsys.readouterr().err.splitlines()[-1].startswith("polemap: ")


@pytest.mark.parametrize("kind", ["drive", "run"])
def test_a_result_that_somebody_added_to_is_kept(
    kind: str, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "in" / kind / "notes.txt").write_text("years of work")
    words = {"run": [*LOCALIZE, "--out", "in/run"], "drive": ["simulate", "x", "--out", "in/drive"]}
    assert cli.run(words[kind]) == cli.USER_ERROR
    assert "did not write and would replace (such as notes.txt)" in capsys.readouterr().err
    assert (place / "in" / kind / "notes.txt").exists()
    (place / "in" / kind / "notes.txt").unlink()
    if kind == "run":
        assert cli.run(words[kind]) == cli.GOOD


def test_a_folder_with_a_marker_of_no_content_is_kept(place: Path) -> None:
    mine = place / "mine"
    mine.mkdir()
    (mine / ".polemap").write_text("made by polemap, which may replace this folder\n")
    (mine / "thesis.tex").write_text("years of work")
    assert cli.run([*LOCALIZE, "--out", "mine"]) == cli.USER_ERROR
    assert (mine / "thesis.tex").read_text() == "years of work"


def test_a_report_is_replaced_whole_and_keeps_its_cache(place: Path) -> None:
    words = ["report", "in/run", "--out", "page"]
    sweep = ["--sweep", "particles=50,150", "--sweep-runs", "1", "--workers", "1"]
    assert cli.run([*words, *sweep]) == cli.GOOD
    kept = contents(place / "page" / "cache")
    assert kept
    assert cli.run(words) == cli.GOOD
    assert contents(place / "page" / "cache") == kept
    assert cli.run([*words, *sweep, "--cache", "page/cache"]) == cli.GOOD
    assert contents(place / "page" / "cache") == kept
    (place / "page" / "cache" / "mine.txt").write_text("x")
    assert cli.run(words) == cli.GOOD
    assert (place / "page" / "cache" / "mine.txt").read_text() == "x"
    assert not list(place.glob("page.*"))


def test_runs_in_a_cache_survive_a_result_that_fails(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*LOCALIZE, "--out", "many", "--runs", "2", "--workers", "1", "--cache", "kept"]

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "many")

    with monkeypatch.context() as patch:
        patch.setattr("polemap.tools.monte_carlo.copy_folder", full)
        assert cli.run(words) == cli.USER_ERROR
    assert capsys.readouterr().err == "polemap: many: No space left on device\n"
    assert not (place / "many").exists()
    (runs,) = (place / "kept").iterdir()
    assert sorted(path.name for path in runs.iterdir()) == ["0", "1"]
    metrics = runs / "0" / "metrics.json"
    whole = metrics.read_bytes()
    for damage in ("{", "[]", "{}", '{"verdict": {"trust": 5}}'):
        metrics.unlink()
        metrics.write_text(damage)
        assert cli.run(words) == cli.USER_ERROR
        (line,) = capsys.readouterr().err.splitlines()
        assert "0/metrics.json: " in line
    metrics.write_bytes(whole)
    assert cli.run(words) == cli.GOOD
    assert {"000", "001"} <= {path.name for path in (place / "many").iterdir()}
    assert list((place / "kept").iterdir()) == []


def test_a_demo_takes_only_a_folder_of_its_own(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "mine").mkdir()
    (place / "mine" / "map.gpkg").write_text("surveyed by hand")
    assert cli.run(["demo", "--out", "mine"]) == cli.USER_ERROR
    assert "such as map.gpkg" in capsys.readouterr().err
    assert (place / "mine" / "map.gpkg").read_text() == "surveyed by hand"


def test_a_map_is_brought_up_to_date_in_its_place(place: Path) -> None:
    words = ["map", "in/drive", "--update", "in/map.gpkg", "--out", "in/map.gpkg"]
    assert cli.run(words) == cli.GOOD
    with reserved(place / "in" / "map.gpkg"):
        pass
    assert {path.name for path in (place / "in").iterdir()} == {
        "drive", "log.csv", "map.gpkg", "run", "settings.yaml",
    }  # fmt: skip


def test_the_same_map_is_the_same_bytes(place: Path) -> None:
    first = [
        "map", "in/drive", "--out", "a.gpkg", "--set", "polemap.mapping.observations_min=2"
    ]  # fmt: skip
    assert cli.run(first) == cli.GOOD
    content = (place / "a.gpkg").read_bytes()
    assert b"2000-01-01T00:00:00.000Z" in content
    assert cli.run(first) == cli.GOOD
    assert (place / "a.gpkg").read_bytes() == content
