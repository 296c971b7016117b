"""One look for all pictures: drawn in light colours, handed to the page as CSS variables."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

mpl.use("Agg")

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

MAX_POINTS = 1500
# at 390 px across, nine points are 12 px high; letters of a title and of a legend in a line
_PHONE_IN, _PHONE_TITLE, _PHONE_LEGEND = 4.1, 46, 66
INK = "#1c2126"
FAINT = "#8a929a"
LINE = "#d4d9de"
SHADE = "#e9ecef"
# Light and dark shade of every colour that carries meaning; the order of laps is a cycle.
THEME: dict[str, tuple[str, str, str]] = {
    "ink": (INK, "#1c2126", "#e6e9ec"),
    "faint": (FAINT, "#6b737b", "#9aa3ab"),
    "line": (LINE, "#d4d9de", "#3b434b"),
    "shade": (SHADE, "#e9ecef", "#2a3138"),
    "kf": ("#0b62a4", "#0b62a4", "#5aaef0"),
    "pf": ("#d1690e", "#d1690e", "#f39a4a"),
    "reference": ("#7b5ea7", "#7b5ea7", "#b79be4"),
    "truth": ("#2a8f4c", "#2a8f4c", "#5fcf86"),
    "added": ("#b0306a", "#b0306a", "#f07aae"),
    "pole": ("#4d7c0f", "#4d7c0f", "#a3d65c"),
}
COLOURS = {name: shades[0] for name, shades in THEME.items()}
LAPS = ("#0b62a5", "#d1690f", "#2a8f4d", "#b0306b", "#7b5ea8", "#0f8b8d", "#8c6d1f", "#5c6770")
_LAPS_DARK = (
    "#5aaef1",
    "#f39a4b",
    "#5fcf87",
    "#f07aaf",
    "#b79be5",
    "#4fd0d2",
    "#d9b65a",
    "#aab4bd",
)

_RC: Any = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}


@dataclass(frozen=True, slots=True)
class Picture:
    """A finished picture: for the page, and as files.

    Attributes:
        key: name of the files, unique in a report.
        svg: a document of its own, light colours.
        png: the same, 150 dots per inch.
        inline: for the page, colours as CSS variables, ids unique in the page.
        narrow: the same for a phone, laid out anew so that text keeps its size.
    """

    key: str
    title: str
    caption: str
    svg: str
    png: bytes
    inline: str
    narrow: str


@contextmanager
def drawing(width_in: float, height_in: float) -> Iterator[Figure]:
    """A figure in the report's style."""
    with mpl.rc_context(_RC):
        yield Figure(figsize=(width_in, height_in), layout="constrained")


def legend_above(axes: Axes, columns: int = 5) -> None:
    """The legend of the axes above the whole figure, where it covers no curve."""
    figure = axes.get_figure(root=True)
    if figure is not None:
        handles, _ = axes.get_legend_handles_labels()
        figure.legend(handles=handles, loc="outside upper right", ncols=columns, fontsize=8)


def finish(figure: Figure, key: str, title: str, caption: str) -> Picture:
    """Render a figure of `drawing`; the same data give the same bytes."""
    with mpl.rc_context({**_RC, "svg.hashsalt": key}):
        vector, raster = io.StringIO(), io.BytesIO()
        figure.savefig(vector, format="svg", metadata={"Date": None, "Creator": None})
        figure.savefig(raster, format="png", dpi=150, facecolor="white")
        _lay_out_narrow(figure)
        narrow = io.StringIO()
        figure.savefig(narrow, format="svg", metadata={"Date": None, "Creator": None})
    svg = vector.getvalue()
    return Picture(
        key,
        title,
        caption,
        svg,
        raster.getvalue(),
        _inline(svg, key, title),
        _inline(narrow.getvalue(), f"{key} narrow", title),
    )


def _lay_out_narrow(figure: Figure) -> None:
    """As wide as a phone, its text as large as before; maps keep their shape."""
    width, height = figure.get_size_inches()
    even = any(axes.get_aspect() != "auto" for axes in figure.axes)
    figure.set_size_inches(_PHONE_IN, height * _PHONE_IN / width if even else height)
    for axes in figure.axes:
        for place in ("left", "center", "right"):
            if title := axes.get_title(loc=place):
                axes.set_title(fill(title, _PHONE_TITLE), loc=place)
    for legend in list(figure.legends):
        labels = [text.get_text() for text in legend.get_texts()]
        source = next(a for a in figure.axes if a.get_legend_handles_labels()[1] == labels)
        legend.remove()
        # beside each stands a sample of its line, about nine letters wide
        widths = np.cumsum(sorted((len(label) + 9 for label in labels), reverse=True))
        legend_above(source, columns=max(1, int(np.sum(widths <= _PHONE_LEGEND))))


def tidy(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Labels of one pair of axes."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title)


def theme_css() -> tuple[str, str]:
    """Declarations of the colour variables, light and dark."""
    light = [f"--c-{name}:{shades[1]}" for name, shades in THEME.items()]
    dark = [f"--c-{name}:{shades[2]}" for name, shades in THEME.items()]
    light += [f"--c-lap{i}:{colour}" for i, colour in enumerate(LAPS)]
    dark += [f"--c-lap{i}:{colour}" for i, colour in enumerate(_LAPS_DARK)]
    return ";".join(light), ";".join(dark)


def _inline(svg: str, key: str, title: str) -> str:
    """The svg element alone, themed, its ids prefixed so that two pictures never share one."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    prefix = re.sub(r"[^a-z0-9]+", "-", key.lower()) + "-"
    body = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}\1"', body)
    body = re.sub(r'"#([^"]+)"', rf'"#{prefix}\1"', body)
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}\1)", body)
    for name, (drawn, _, _) in THEME.items():
        body = body.replace(drawn, f"var(--c-{name})")
    for number, colour in enumerate(LAPS):
        body = body.replace(colour, f"var(--c-lap{number})")
    # Sizes come from the style sheet: the picture fills its column.
    head_end = body.index(">")
    head = re.sub(r'\s(width|height)="[^"]*"', "", body[:head_end])
    label = title.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return f'{head} role="img" aria-label="{label}"{body[head_end:]}'


def plain_log(axes: Axes) -> None:
    """A logarithmic x axis with plain numbers: text here is never read as mathematics."""
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def shade_runs(axes: Axes, station: Floats, mask: NDArray[np.bool_]) -> None:
    """Shade the stations where `mask` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    for first, last in edges.reshape(-1, 2):
        axes.axvspan(station[first], station[last - 1], color=SHADE, lw=0, zorder=0)


def thin(x: Floats, y: Floats, most: int = MAX_POINTS) -> tuple[Floats, Floats]:
    """At most `most` points; of every group the extremes stay, so that no peak disappears."""
    if len(x) <= most:
        return x, y
    group = int(np.ceil(2 * len(x) / most))
    count = len(x) // group
    blocks = np.nan_to_num(y[: count * group]).reshape(count, group)
    rows = np.column_stack([blocks.argmin(axis=1), blocks.argmax(axis=1)])
    rows = np.sort(rows, axis=1) + group * np.arange(count)[:, None]
    keep = np.unique(np.concatenate([rows.ravel(), [len(x) - 1]]))
    return x[keep], y[keep]
