"""How QGIS shows a pole map: a style by existence, kept in the GeoPackage itself.

QGIS looks for its styles in a table `layer_styles` of the GeoPackage and opens a layer with the row
that is marked as the default of its name. The table has no geometry and is listed in
`gpkg_contents` as attributes (OGC GeoPackage 1.3, clause 2.4), so that other programs accept it.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

NAME = "existence"
COLUMN = "existence"

# as QGIS itself creates it when a user saves a style
TABLE = """
CREATE TABLE layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256),
  f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256),
  styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT,
  owner TEXT(30), ui TEXT(30), update_time DATETIME DEFAULT CURRENT_TIMESTAMP)
"""
REGISTER = """
INSERT INTO gpkg_contents (table_name, data_type, identifier, description)
VALUES ('layer_styles', 'attributes', 'layer_styles', 'styles of QGIS')
"""
INSERT = """
INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column,
  styleName, styleQML, styleSLD, useAsDefault, description, owner, update_time)
VALUES ('', '', ?, ?, ?, ?, '', 1, ?, '', '2000-01-01T00:00:00.000Z')
"""
# the same map is the same bytes: when it was written stands in the file system
STAMPS = (
    "UPDATE gpkg_contents SET last_change = '2000-01-01T00:00:00.000Z'",
    "UPDATE gpkg_metadata_reference SET timestamp = '2000-01-01T00:00:00.000Z'",
)


@dataclass(frozen=True, slots=True)
class Class:
    """Poles from `lower` to `upper` of existence: their words, colour (RGB) and size."""

    lower: float
    upper: float
    label: str
    colour: tuple[int, int, int]
    size_mm: float


# from blue-green to red, apart for the colour-blind too; what is doubtful is also smaller
CLASSES = (
    Class(0.0, 0.5, "gone, or not yet proven (below 0.5)", (150, 150, 150), 1.6),
    Class(0.5, 0.8, "seen by one drive, or missed often (0.5 to 0.8)", (213, 94, 0), 2.2),
    Class(0.8, 0.95, "likely (0.8 to 0.95)", (240, 200, 50), 2.6),
    Class(0.95, 1.0, "confirmed (0.95 and more)", (0, 114, 90), 2.8),
)


def style_rows(layers: dict[str, str]) -> list[tuple[str, str, str, str, str]]:
    """What `INSERT` takes, a row a layer; `layers` maps names to their geometry columns."""
    text = style_qml()
    about = "poles by the probability that they stand there"
    return [(layer, geometry, NAME, text, about) for layer, geometry in layers.items()]


def style_qml() -> str:
    """A graduated renderer on `existence`, as QGIS 3 stores it."""
    root = ElementTree.Element("qgis", version="3.28.0", styleCategories="Symbology")
    renderer = ElementTree.SubElement(
        root, "renderer-v2", type="graduatedSymbol", attr=COLUMN, graduatedMethod="GraduatedColor",
        symbollevels="0", enableorderby="0", forceraster="0",
    )  # fmt: skip
    ranges = ElementTree.SubElement(renderer, "ranges")
    symbols = ElementTree.SubElement(renderer, "symbols")
    for number, entry in enumerate(CLASSES):
        ElementTree.SubElement(
            ranges, "range", symbol=str(number), lower=f"{entry.lower:.15f}",
            upper=f"{entry.upper:.15f}", label=entry.label, render="true",
        )  # fmt: skip
        _symbol(symbols, number, entry)
    body = ElementTree.tostring(root, encoding="unicode")
    return f"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n{body}"


def _symbol(symbols: ElementTree.Element, number: int, entry: Class) -> None:
    symbol = ElementTree.SubElement(
        symbols, "symbol", type="marker", name=str(number), alpha="1", clip_to_extent="1",
        force_rhr="0",
    )  # fmt: skip
    layer = ElementTree.SubElement(
        symbol, "layer", {"class": "SimpleMarker", "enabled": "1", "locked": "0", "pass": "0"}
    )
    options = ElementTree.SubElement(layer, "Option", type="Map")
    red, green, blue = entry.colour
    values = {
        "name": "circle",
        "color": f"{red},{green},{blue},255",
        "outline_color": "30,30,30,255",
        "outline_style": "solid",
        "outline_width": "0.2",
        "outline_width_unit": "MM",
        "size": f"{entry.size_mm}",
        "size_unit": "MM",
    }
    for name, value in values.items():
        ElementTree.SubElement(options, "Option", type="QString", name=name, value=value)
