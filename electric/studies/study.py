"""What every study brings: a table of figures beside a paper's claims, and its pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Report = Callable[[int], None]
"""Called with the number of runs that are done."""


@dataclass(frozen=True, slots=True)
class Line:
    """A row of a study's table."""

    name: str
    ours: str
    expected: str
    claim: str


@dataclass(frozen=True, slots=True)
class Curve:
    """A picture's curve over time."""

    label: str
    stamp_s: Floats
    value: Floats


def curves_of(runs: Mapping[str, Any], field: str, scale: float = 1.0) -> tuple[Curve, ...]:
    """A field of several runs as curves, times `scale`; a run has its own `stamp_s`."""
    return tuple(Curve(n, run.stamp_s, scale * getattr(run, field)) for n, run in runs.items())


@dataclass(frozen=True, slots=True)
class Panel:
    """Curves that share an axis: its label with the unit, and values to mark by a line across."""

    label: str
    curves: tuple[Curve, ...]
    marks: tuple[float, ...] = ()
    x_label: str = "time, s"
    log_x: bool = False


def sideslip_panels(curves: tuple[Curve, ...]) -> tuple[Panel, ...]:
    """Side-slips and their errors; the truth comes first."""
    if not curves:
        return ()
    truth = curves[0]
    errors = [Curve(c.label, c.stamp_s, np.degrees(c.value - truth.value)) for c in curves[1:]]
    degrees = [Curve(c.label, c.stamp_s, np.degrees(c.value)) for c in curves]
    return (
        Panel("side-slip, degrees", tuple(degrees)),
        Panel("side-slip error, degrees", tuple(errors), (0.0,)),
    )


@dataclass(frozen=True, slots=True)
class Shown:
    """A grey picture of a study, `(rows, columns)`, and lines `(n, 2, 2)` in its pixels."""

    label: str
    image: NDArray[np.uint8] | NDArray[np.uint16]
    lines_px: Floats


@dataclass(frozen=True, slots=True)
class Study:
    """What a study brings.

    `curves` are side-slips in the first drive, truth first; a study with `panels` shows those
    instead. `headings` are the three columns beside a row's name. `shown` are pictures of the first
    drive.
    """

    name: str
    title: str
    lines: tuple[Line, ...]
    curves: tuple[Curve, ...]
    remarks: tuple[str, ...]
    figures: dict[str, float]
    panels: tuple[Panel, ...] = ()
    headings: tuple[str, str, str] = ("ours", "errata", "the paper says")
    shown: tuple[Shown, ...] = ()
