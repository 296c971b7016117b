"""`--background`: an OpenStreetMap extract under the map of a picture and of a report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.extras import need
from polemap.tools.background import ATTRIBUTION, read_background
from polemap.tools.cli import GOOD, USER_ERROR, run
from polemap.tools.map_picture import draw_map
from tests.pole_maps import plain_map

osmium = need("osmium")
FRAME = EarthFrame("utm", 32633)
CENTRE = np.array([383_800.0, 5_812_300.0])


def write_town(
    path: Path,
    centre: Sequence[float] = tuple(CENTRE),
    frame: EarthFrame = FRAME,
    ways: Sequence[tuple[dict[str, str], list[list[float]]]] = (
        ({"highway": "residential"}, [[-80, 0], [0, 0], [80, 5]]),
        ({"highway": "footway"}, [[-80, 6], [80, 9]]),
        ({"railway": "tram"}, [[-80, -8], [80, -8]]),
        ({"waterway": "stream"}, [[-50, 40], [50, 44]]),
        ({"building": "yes"}, [[10, 15], [30, 15], [30, 30], [10, 30], [10, 15]]),
        ({"building": "no"}, [[-10, 15], [-30, 15], [-30, 30], [-10, 30], [-10, 15]]),
        ({"leisure": "park"}, [[-70, 10], [-40, 10], [-40, 30], [-70, 10]]),
        ({"natural": "water"}, [[40, 40], [60, 40], [60, 60], [40, 40]]),
        ({"power": "line"}, [[-80, -20], [80, -20]]),
        ({"highway": "primary"}, [[5000, 0], [6000, 0]]),
    ),
) -> Path:
    """Ways in metres about a place; a closed one ends at the node where it begins."""
    node, made = 1, []
    with osmium.SimpleWriter(str(path)) as writer:
        for tags, points in ways:
            closed = len(points) > 2 and points[0] == points[-1]
            kept = points[:-1] if closed else points
            place = geographic_from_grid(frame, np.array(kept, dtype=float) + centre)
            ids = list(range(node, node + len(kept)))
            node += len(kept)
            for number, (latitude, longitude) in zip(ids, place.tolist(), strict=True):
                writer.add_node(
                    osmium.osm.mutable.Node(id=number, location=(longitude, latitude), version=1)
                )
            made.append((tags, [*ids, ids[0]] if closed else ids))
        for number, (tags, ids) in enumerate(made, start=1):
            writer.add_way(osmium.osm.mutable.Way(id=number, nodes=ids, tags=tags, version=1))
    return path


@pytest.mark.parametrize("ending", [".osm.pbf", ".osm"])
def test_what_lies_around_is_read(tmp_path: Path, ending: str) -> None:
    path = write_town(tmp_path / f"town{ending}")
    found = read_background(path, FRAME, CENTRE + np.array([[-20.0, 0.0], [20.0, 0.0]]))
    assert {kind: len(ways) for kind, ways in found.areas.items()} == {
        "green": 1, "water": 1, "building": 1,
    }  # fmt: skip
    assert {kind: len(ways) for kind, ways in found.lines.items()} == {
        "water": 1, "rail": 1, "path": 1, "road": 1,
    }  # fmt: skip
    # to the centimetre of the format
    road = found.lines["road"][0] - CENTRE
    np.testing.assert_allclose(road, [[-80, 0], [0, 0], [80, 5]], atol=0.02)
    house = found.areas["building"][0] - CENTRE
    np.testing.assert_allclose([house.min(), house.max()], [10, 30], atol=0.02)


def test_a_road_whose_nodes_are_missing_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "cut.osm"
    place = geographic_from_grid(FRAME, CENTRE + np.array([[0.0, 0.0], [9.0, 0.0], [18.0, 0.0]]))
    nodes = "".join(
        f'<node id="{n}" lat="{lat}" lon="{lon}"/>' for n, (lat, lon) in enumerate(place, 1)
    )
    ways = "".join(
        f'<way id="{n}"><nd ref="{a}"/><nd ref="{b}"/><nd ref="{c}"/>'
        '<tag k="highway" v="service"/></way>'
        for n, (a, b, c) in enumerate([(1, 2, 99), (3, 98, 97)], 1)
    )
    path.write_text(f'<osm version="0.6">{nodes}{ways}</osm>')
    (road,) = read_background(path, FRAME, CENTRE[None]).lines["road"]
    assert len(road) == 2


def test_refusals(tmp_path: Path) -> None:
    here = CENTRE[None]
    town = write_town(tmp_path / "town.osm.pbf")
    with pytest.raises(InputError, match=r"none.osm: no such OpenStreetMap extract"):
        read_background(tmp_path / "none.osm", FRAME, here)
    with pytest.raises(InputError, match=r"m.geojson: a background is an OpenStreetMap extract"):
        read_background(tmp_path / "m.geojson", FRAME, here)
    with pytest.raises(FrameError, match="a background needs a map on the earth"):
        read_background(town, EarthFrame("local", name="yard"), here)
    far = here + 9000.0
    with pytest.raises(InputError, match=r"nothing in it lies around the map, which is at lat"):
        read_background(town, FRAME, far)
    for name, data in {
        "noise.osm.pbf": b"\x00\x01 not a map at all",
        "cut.osm.pbf": town.read_bytes()[:-40],
        "empty.osm.pbf": b"",
        "page.osm": b"<html><body>moved</body></html>",
        "cut.osm": b'<osm version="0.6"><node id="1"',
        "bomb.osm": b'<!DOCTYPE osm [<!ENTITY a "aa">]><osm version="0.6">&a;</osm>',
        "odd.osm": b'<osm version="0.6"><node id="1" lat="123" lon="x"/></osm>',
    }.items():
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(InputError, match=name) as caught:
            read_background(path, FRAME, here)
        assert "\n" not in str(caught.value)


def test_under_a_report(
    make_runs: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    east, north = CENTRE.tolist()
    runs = make_runs(tmp_path / "campus", runs=1, laps=2, origin_m=(east, north), epsg=FRAME.epsg)
    asked = ["report", str(runs), "--out", str(tmp_path / "report"), "--background"]
    assert run([*asked, str(tmp_path / "none.osm.pbf")]) == USER_ERROR
    assert "no such OpenStreetMap extract" in capsys.readouterr().err
    assert run([*asked, str(write_town(tmp_path / "town.osm.pbf"))]) == GOOD
    page = (tmp_path / "report" / "report.html").read_text()
    assert ATTRIBUTION in page
    assert 'class="osm line road"' in page
    (picture,) = (tmp_path / "report" / "pictures").glob("*map-picture.svg")
    assert ATTRIBUTION in picture.read_text()


def test_under_a_report_that_is_nowhere(
    make_runs: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = make_runs(tmp_path / "campus", runs=1, laps=2)
    town = write_town(tmp_path / "town.osm.pbf")
    asked = ["report", str(runs), "--out", str(tmp_path / "report"), "--background", str(town)]
    assert run(asked) == USER_ERROR
    assert "a background needs a map on the earth" in capsys.readouterr().err


def test_under_a_map(tmp_path: Path) -> None:
    points = CENTRE + np.array([[0.0, 5.0], [20.0, -5.0], [40.0, 5.0]])
    pole_map = replace(plain_map(points), frame=FRAME)
    under = read_background(write_town(tmp_path / "town.osm.pbf"), FRAME, points)
    draw_map(pole_map, [], tmp_path / "a.svg", under)
    draw_map(pole_map, [], tmp_path / "b.svg")
    with_it, without = ((tmp_path / f"{name}.svg").read_text() for name in "ab")
    assert "OpenStreetMap" in with_it
    assert "OpenStreetMap" not in without


def test_a_background_without_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    town = write_town(tmp_path / "town.osm.pbf")
    asked = ["map", "drive", "--out", str(tmp_path / "m.gpkg"), "--background", str(town)]
    assert run(asked) == USER_ERROR
    assert "--background lies under a picture: add --picture" in capsys.readouterr().err
