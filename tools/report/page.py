"""The page: one HTML file that needs nothing else, safe against text that comes from drives."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from importlib.resources import files

from jinja2 import Environment, FunctionLoader, StrictUndefined

from polemap.tools.report.interactive_map import InteractiveMap
from polemap.tools.report.photos import Photo
from polemap.tools.report.slam_section import SlamSection
from polemap.tools.report.style import Picture, theme_css
from polemap.tools.report.summary import RouteSummary
from polemap.tools.report.tables import Table, csv_text


@dataclass(frozen=True, slots=True)
class SettingsText:
    """The settings of one run set, as they were used."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Section:
    """One route on the page."""

    anchor: str
    title: str
    map: InteractiveMap | None
    pictures: tuple[Picture, ...]
    configs: tuple[SettingsText, ...]
    photos: tuple[Photo, ...] = ()


@dataclass(frozen=True, slots=True)
class Page:
    """Everything that stands on the page, in its order."""

    title: str
    version: str
    made: str
    machine: str
    head_tables: tuple[Table, ...]
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...]
    sections: tuple[Section, ...]
    notes: tuple[str, ...]
    summaries: tuple[RouteSummary, ...] = ()
    slam: tuple[SlamSection, ...] = ()


def render_page(page: Page) -> str:
    """The HTML text.

    Every text passes through the template's escaping; the only unescaped parts are this
    package's own style sheet and script, and pictures whose text their renderer has escaped. A
    content security policy allows no script but that one, by its hash.
    """
    templates = files("polemap.tools.report") / "templates"
    script = (templates / "page.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    template = page_environment().get_template("report.html.j2")
    return template.render(
        css=style_sheet(),
        script=script,
        script_hash=f"sha256-{digest}",
        **{name: getattr(page, name) for name in Page.__dataclass_fields__},
    )


def page_environment() -> Environment:
    """Renders this package's templates; every text is escaped."""
    templates = files("polemap.tools.report") / "templates"
    loader = FunctionLoader(lambda name: (templates / name).read_text(encoding="utf-8"))
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["csv_address"] = _csv_address
    return environment


def style_sheet() -> str:
    """The style of every page, light and dark."""
    light, dark = theme_css()
    css = (files("polemap.tools.report") / "templates" / "page.css").read_text(encoding="utf-8")
    return css.replace("@LIGHT@", light).replace("@DARK@", dark)


def _csv_address(table: Table) -> str:
    """The table as a file to be saved from the page, which needs no other file."""
    return "data:text/csv;base64," + base64.b64encode(csv_text(table).encode()).decode("ascii")
