"""Maps for other programs: OpenStreetMap PBF, styles for QGIS, the structure of OpenDRIVE."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import osmium
import pyogrio
import pytest

from polemap.build.map_diff import match_points
from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import geographic_from_grid
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.map.formats import opendrive
from polemap.map.io import export_map, read_map, write_map
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN
from polemap.vehicle.pose import rotate
from tests.polemap.map.test_map_io import LOCAL, make_map

# ---- OpenStreetMap PBF


def test_pbf_is_read_by_other_programs(tmp_path: Path) -> None:
    pole_map = make_map(n=40)
    path = tmp_path / "lamps.osm.pbf"
    export_map(pole_map, path)
    table = pyogrio.read_dataframe(path, layer="points")
    assert table.crs.to_epsg() == 4326
    assert set(table["man_made"]) == {"utility_pole"}
    ids = -table["osm_id"].astype(np.int64).to_numpy() - 1
    place = geographic_from_grid(pole_map.frame, pole_map.points_m)[np.argsort(pole_map.ids)]
    order = np.argsort(ids)
    np.testing.assert_array_equal(ids[order], np.sort(pole_map.ids))
    # PBF counts positions in 1e-7 degrees
    np.testing.assert_allclose(table.geometry.y.to_numpy()[order], place[:, 0], atol=0.51e-7)
    np.testing.assert_allclose(table.geometry.x.to_numpy()[order], place[:, 1], atol=0.51e-7)


def test_pbf_comes_back_as_an_inventory(tmp_path: Path) -> None:
    pole_map = make_map(n=40)
    path = tmp_path / "lamps.osm.pbf"
    export_map(pole_map, path)
    back = read_map(path)
    assert back.frame == pole_map.frame
    pairs = match_points(pole_map.points_m, back.points_m, 0.02)
    assert len(pairs) == len(pole_map)
    np.testing.assert_allclose(back.width_m[pairs[:, 1]], pole_map.width_m[pairs[:, 0]], atol=6e-4)


def test_pbf_of_others(tmp_path: Path) -> None:
    """An extract with ways and nodes of no interest: only what stands like a pole is taken."""
    path = tmp_path / "town.osm.pbf"
    with osmium.SimpleWriter(str(path)) as writer:
        for number, tags in enumerate(
            ({}, {"highway": "street_lamp", "height": "6 m"}, {"amenity": "bench"}), start=1
        ):
            writer.add_node(
                osmium.osm.mutable.Node(id=number, location=(8.4, 49.0 + number / 1e3), tags=tags)
            )
        writer.add_way(osmium.osm.mutable.Way(id=9, nodes=[1, 2], tags={"highway": "residential"}))
    pole_map = read_map(path)
    assert len(pole_map) == 1
    assert pole_map.height_m[0] == 6.0
    np.testing.assert_allclose(
        geographic_from_grid(pole_map.frame, pole_map.points_m), [[49.002, 8.4]], atol=1e-7
    )


def test_pbf_refusals(tmp_path: Path) -> None:
    with pytest.raises(FrameError, match="OpenStreetMap needs WGS84 positions"):
        export_map(make_map(LOCAL), tmp_path / "m.osm.pbf")
    path = tmp_path / "m.pbf"
    path.write_bytes(b"\x00\x01 not a map at all")
    with pytest.raises(InputError, match=r"m.pbf: not an OpenStreetMap PBF file"):
        read_map(path)
    with osmium.SimpleWriter(str(tmp_path / "none.osm.pbf")) as writer:
        writer.add_node(osmium.osm.mutable.Node(id=1, location=(8.4, 49.0), tags={"a": "b"}))
    with pytest.raises(InputError, match=r"none.osm.pbf: no node in it is a lamp"):
        read_map(tmp_path / "none.osm.pbf")


# ---- QGIS


def test_a_geopackage_opens_styled_in_qgis(tmp_path: Path) -> None:
    path = tmp_path / "m.gpkg"
    write_map(replace(make_map(), doubtful=make_map(n=2, seed=9)), path)
    with closing(sqlite3.connect(path)) as database:
        styles = {
            # what QGIS asks for when it opens a layer
            layer: database.execute(
                "SELECT styleQML FROM layer_styles WHERE f_table_schema = '' AND f_table_name = ? "
                "AND f_geometry_column = ? ORDER BY CASE WHEN useAsDefault THEN 1 ELSE 2 END, "
                "update_time DESC LIMIT 1",
                (layer, pyogrio.read_info(path, layer)["geometry_name"]),
            ).fetchone()[0]
            for layer in ("poles", "doubtful")
        }
        listed = database.execute(
            "SELECT data_type FROM gpkg_contents WHERE table_name = 'layer_styles'"
        ).fetchall()
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert listed == [("attributes",)]
    for text in styles.values():
        check_graduated(text)
    kinds = {str(name): kind for name, kind in pyogrio.list_layers(path)}
    assert kinds == {"poles": "Point", "doubtful": "Point", "layer_styles": None}
    columns = pyogrio.read_info(path, "layer_styles")["fields"]
    assert {"f_table_name", "styleName", "styleQML", "useAsDefault"} <= set(columns)


def check_graduated(text: str) -> None:
    """Classes of existence from 0 to 1 without a gap, each with a symbol of its own."""
    assert text.startswith("<!DOCTYPE qgis")
    root = ElementTree.fromstring(text)
    renderer = root.find("renderer-v2")
    assert renderer is not None
    assert (renderer.get("type"), renderer.get("attr")) == ("graduatedSymbol", "existence")
    ranges = renderer.findall("ranges/range")
    bounds = [(float(r.get("lower", "")), float(r.get("upper", ""))) for r in ranges]
    assert bounds[0][0] == 0.0
    assert bounds[-1][1] == 1.0
    for (_, upper), (lower, _) in pairwise(bounds):
        assert upper == lower
    symbols = {s.get("name"): s for s in renderer.findall("symbols/symbol")}
    assert [r.get("symbol") for r in ranges] == list(symbols)
    colours = set()
    for symbol in symbols.values():
        assert symbol.get("type") == "marker"
        layer = symbol.find("layer")
        assert layer is not None
        assert layer.get("class") == "SimpleMarker"
        options = {o.get("name"): o.get("value", "") for o in layer.findall("Option/Option")}
        assert float(options["size"]) > 0
        assert len(options["color"].split(",")) == 4
        colours.add(options["color"])
    assert len(colours) == len(symbols)


# ---- OpenDRIVE

Check = Callable[[str], bool]


def number(text: str) -> bool:
    return bool(np.isfinite(float(text)))


def not_negative(text: str) -> bool:
    return float(text) >= 0.0


def positive(text: str) -> bool:
    return float(text) > 0.0


def one_of(*words: str) -> Check:
    return lambda text: text in words


def any_text(text: str) -> bool:
    return True


# the part of ASAM OpenDRIVE 1.7.0 that a map of poles needs, in our own words: reference line
# (chapter 7), roads (8), lanes (9), objects (11). For each element its attributes (a star:
# required) and its children in their order (a star: at least one). The schema files of ASAM may
# not be handed on here; documents of ours were checked against those of 1.7.0 and 1.8.0 by hand.
STRUCTURE: dict[str, tuple[dict[str, Check], list[str]]] = {
    "OpenDRIVE": ({}, ["header*", "road*"]),
    "header": (
        {
            "revMajor*": one_of("1"), "revMinor*": one_of("7"), "name": any_text,
            "version": any_text, "north": number, "south": number, "east": number, "west": number,
        },
        ["geoReference"],
    ),
    "geoReference": ({}, []),
    "road": (
        {"name": any_text, "length*": positive, "id*": any_text, "junction*": one_of("-1")},
        ["planView*", "lanes*", "objects"],
    ),
    "planView": ({}, ["geometry*"]),
    "geometry": (
        {"s*": not_negative, "x*": number, "y*": number, "hdg*": number, "length*": positive},
        ["line*"],
    ),
    "line": ({}, []),
    "lanes": ({}, ["laneSection*"]),
    "laneSection": ({"s*": not_negative}, ["left", "center*", "right"]),
    "center": ({}, ["lane*"]),
    "right": ({}, ["lane*"]),
    "lane": (
        {"id*": lambda text: int(text) <= 0, "type*": one_of("none"),
         "level": one_of("true", "false")},
        ["width"],
    ),
    "width": (
        {"sOffset*": not_negative, "a*": number, "b*": number, "c*": number, "d*": number}, []
    ),
    "objects": ({}, ["object"]),
    "object": (
        {
            "id*": any_text, "s*": not_negative, "t*": number, "zOffset*": number,
            "name": any_text, "type": one_of("pole", "building", "roadMark", "none"),
            "subtype": any_text, "hdg": number, "pitch": number,
            "roll": number, "orientation": one_of("+", "-", "none"),
            "dynamic": one_of("yes", "no"), "radius": positive, "height": not_negative,
        },
        ["outlines", "userData"],
    ),
    "outlines": ({}, ["outline*"]),
    "outline": (
        {"id": not_negative, "closed": one_of("true", "false"), "outer": one_of("true", "false")},
        ["cornerRoad*"],
    ),
    "cornerRoad": (
        {"id": not_negative, "s*": not_negative, "t*": number, "dz*": number, "height*": number},
        [],
    ),
    "userData": ({"code*": any_text, "value": any_text}, []),
}  # fmt: skip


def faults(element: ElementTree.Element) -> list[str]:
    """What in an element and below it is not as the structure has it."""
    attributes, children = STRUCTURE[element.tag]
    allowed = {name.rstrip("*"): check for name, check in attributes.items()}
    found = [f"{element.tag}: {name}" for name in element.attrib if name not in allowed]
    for name, check in attributes.items():
        text = element.get(name.rstrip("*"))
        if text is None:
            found += [f"{element.tag}: no {name}"] if name.endswith("*") else []
        elif not check(text):
            found.append(f"{element.tag}: {name} is {text}")
    order = [name.rstrip("*") for name in children]
    tags = [child.tag for child in element]
    found += [f"{element.tag}: holds {tag}" for tag in tags if tag not in order]
    known = [order.index(tag) for tag in tags if tag in order]
    found += [] if known == sorted(known) else [f"{element.tag}: order {tags}"]
    found += [
        f"{element.tag}: no {name}"
        for name in children
        if name.endswith("*") and name.rstrip("*") not in tags
    ]
    for child in element:
        if child.tag in order:
            found += faults(child)
    return found


@pytest.mark.parametrize("frame", [make_map().frame, LOCAL], ids=["utm", "local"])
def test_opendrive_has_the_structure_of_the_standard(frame: object) -> None:
    pole_map = make_map(n=30) if frame != LOCAL else make_map(LOCAL, 30)
    root = ElementTree.fromstring(opendrive.to_xml(pole_map))
    assert faults(root) == []
    ids = [entry.get("id") for entry in root.iter("object")]
    assert len(set(ids)) == len(pole_map)
    length = float(root.find("road").get("length"))  # type: ignore[union-attr, arg-type]
    assert all(float(entry.get("s", "nan")) <= length for entry in root.iter("object"))


def test_opendrive_holds_corners_and_lines_where_they_are() -> None:
    points = make_map(n=3)
    kinds = np.array([LandmarkKind.POLE, LandmarkKind.CORNER, LandmarkKind.CORNER], dtype=np.int8)
    vertices = points.points_m.mean(axis=0) + np.array([[-900.0, 3.0], [0.0, 4.0], [900.0, 3.0]])
    lines = LineMap(
        frame=points.frame, vertices_m=np.concatenate([vertices, vertices + 5.0]),
        vertex_sd_m=np.full(6, 0.1), ids=np.array([0, 1]), count=np.array([3, 3]),
        kind=np.array([LandmarkKind.LANE_MARKING, LandmarkKind.KERB], dtype=np.int8),
        style=np.array([LineStyle.DASHED, LineStyle.UNKNOWN], dtype=np.int8),
        observations=np.array([9, 9]), drives=np.array([1, 1]), existence=np.array([0.9, 0.8]),
    )  # fmt: skip
    pole_map = replace(points, lines=lines, extra={KIND_COLUMN: kinds})
    root = ElementTree.fromstring(opendrive.to_xml(pole_map))
    assert faults(root) == []
    objects = list(root.iter("object"))
    assert len({entry.get("id") for entry in objects}) == 5
    assert [entry.get("type") for entry in objects] == [
        "pole", "building", "building", "roadMark", "none"
    ]  # fmt: skip
    assert objects[4].get("subtype") == "kerb"
    geometry = next(root.iter("geometry"))
    start = np.array([float(geometry.get(axis, "nan")) for axis in "xy"])
    heading = float(geometry.get("hdg", "nan"))
    corners = [
        [float(corner.get(axis, "nan")) for axis in "st"]
        for corner in objects[3].iter("cornerRoad")
    ]
    np.testing.assert_allclose(
        rotate(np.array(corners), heading) + start, vertices, atol=2e-4, rtol=0.0
    )
    assert float(next(root.iter("road")).get("length", "nan")) >= corners[2][0]


def test_the_structure_finds_faults() -> None:
    good = opendrive.to_xml(make_map())
    for wrong, message in (
        (good.replace(b' zOffset="0"', b"", 1), "object: no zOffset"),
        (good.replace(b'type="pole"', b'type="post"', 1), "object: type is post"),
        (good.replace(b'revMinor="7"', b'revMinor="9"'), "header: revMinor"),
        (good.replace(b"<lanes>", b"<objects/><lanes>"), "road: order"),
    ):
        found = faults(ElementTree.fromstring(wrong))
        assert any(fault.startswith(message) for fault in found), (message, found)
