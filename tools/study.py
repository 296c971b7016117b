"""`polemap study`: a source paper's simulation again, our figures beside its claims."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.figure import Figure

from drivelog.atomic import atomic_file, atomic_folder
from drivelog.errors import ConfigError
from tools.progress import progress
from vehicle.io import load_car
from vehicle.studies.papers import STUDIES, Study

_TABLE = "{:<54} {:>20} {:>11}  {}"
_STYLES = ("k-", "C0-", "C1-", "C2-", "C3-", "C4-")


def command(
    name: Annotated[str, typer.Argument(help="W12, W13, W14 or N13; all runs them all.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for picture, table and figures.")
    ] = None,
    seeds: Annotated[int | None, typer.Option("--seeds", min=1, help="Simulated drives.")] = None,
    vehicle: Annotated[
        str, typer.Option("--vehicle", help="Car, the papers' by default.")
    ] = "coms",
) -> None:
    """Rerun a source paper's simulation and set our figures beside its claims.

    Ratios and orderings are compared, since the papers print no noise and no steering amplitude.
    The column errata holds what an independent simulation of the corrected equations gave.

    Examples:
        polemap study W14
        polemap study W13 --seeds 20 --out w13
        polemap study all --out studies
    """
    chosen = list(STUDIES) if name == "all" else [name.upper()]
    if chosen[0] not in STUDIES:
        raise ConfigError(f"no study {name}; there are {', '.join(STUDIES)} and all")
    car = load_car(vehicle)
    results = []
    for each in chosen:
        function, usual = STUDIES[each]
        count = seeds or usual
        with progress(None, f"study {each}") as advance:
            results.append(function(car, count, advance))
        sys.stdout.write(table(results[-1], count) + "\n")
        sys.stdout.flush()
    if out is not None:
        with atomic_folder(out) as folder:
            for result in results:
                write_study(result, folder)


def table(study: Study, seeds: int) -> str:
    """The study as text."""
    lines = [f"{study.name}: {study.title} ({seeds} seeds)"]
    lines.append(_TABLE.format("", "ours", "errata", "the paper says"))
    lines += [_TABLE.format(x.name, x.ours, x.expected, x.claim).rstrip() for x in study.lines]
    lines += [f"  - {remark}" for remark in study.remarks]
    return "\n".join(lines) + "\n"


def write_study(study: Study, folder: Path) -> None:
    """`NAME.json` with the figures and `NAME.png` with side-slip and error over time."""
    with atomic_file(folder / f"{study.name}.json") as part:
        part.write_text(json.dumps(study.figures, indent=1), "utf-8")
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    truth = study.curves[0]
    for curve, style in zip(study.curves, _STYLES, strict=False):
        upper.plot(curve.stamp_s, np.degrees(curve.value), style, lw=1.2, label=curve.label)
        if curve is not truth:
            error = np.degrees(curve.value - truth.value)
            lower.plot(curve.stamp_s, error, style, lw=1.0, label=curve.label)
    upper.set_ylabel("side-slip, degrees")
    lower.set_ylabel("error, degrees")
    lower.set_xlabel("time, s")
    upper.set_title(f"{study.name}: {study.title}, first seed")
    upper.legend(loc="upper right", ncols=2)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    with atomic_file(folder / f"{study.name}.png") as part:
        figure.savefig(str(part), dpi=110)
