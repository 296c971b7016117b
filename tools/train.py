"""`polemap train`: the pole classifier from drives with a known pole map."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from polemap import __version__
from polemap.detect.classifier import PoleClassifier
from polemap.detect.models.io import write_classifier
from polemap.drivelog.atomic import check_file
from polemap.drivelog.errors import ConfigError
from polemap.drivelog.readers.registry import open_drive
from polemap.map.io import read_map
from polemap.settings import Settings, load_settings
from polemap.stereo.matching import make_matcher
from polemap.tools.option_types import ConfigOption, SetOption, TopicsOption
from polemap.tools.progress import progress
from polemap.training import (
    Judgement,
    Samples,
    TrainingConfig,
    collect,
    cross_validate,
    join,
    judge,
    train,
)


class Learned(StrEnum):
    """Names of `KindName` that a model is for, for the command line."""

    pole = "pole"
    corner = "corner"


def command(
    drives: Annotated[list[str], typer.Argument(help="DRIVE=MAP pairs.")],
    out: Annotated[Path, typer.Option("--out", help="JSON file of the model.")],
    unmapped: Annotated[
        list[str] | None,
        typer.Option("--unmapped", help="DRIVE=MAP of true poles that the drive's map lacks."),
    ] = None,
    parts: Annotated[
        int, typer.Option("--parts", min=1, help="Stretches of a drive for cross-validation.")
    ] = 1,
    every: Annotated[int, typer.Option("--every", min=1, help="Use every n-th frame.")] = 1,
    kind: Annotated[
        Learned, typer.Option("--kind", help="What the maps hold and the model is to know.")
    ] = Learned.pole,
    topics: TopicsOption = None,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Train the classifier of poles, or of corners, on drives with a known pole map.

    Examples:
      polemap train sim_1=sim_1/objects.geojson sim_2=sim_2/objects.geojson --out poles.json
      polemap train kitti/sequences/03=kitti/poles/03.csv --parts 2 --out poles.json
      polemap train sim_1=sim_1/corners.csv --parts 2 --kind corner --out corners.json
      polemap detect DRIVE --out DIR --set polemap.detection.model=poles.json

    Hypotheses near a mapped pole count as poles, those far from all as other things. The printed
    figures come from models that did not see the drive, or the part of it, that is judged.
    """
    settings = load_settings(config, set_values)
    pairs, lacking = _pairs(drives), dict(_pairs(unmapped or []))
    inputs = [place for pair in [*pairs, *lacking.items()] for place in pair]
    check_file(out, [*inputs, config, topics], (".json",))
    training = TrainingConfig(every=every, kind=kind.value)
    gathered = [
        _collect(drive, pole_map, lacking.get(drive), settings, training, parts, topics)
        for drive, pole_map in pairs
    ]
    samples = join(gathered)
    crossed = None
    if len(samples.groups) > 1:
        crossed = judge(cross_validate(samples, training), samples.is_pole)
    model = train(
        samples,
        training,
        {**_origin(samples, crossed, training), **_source(pairs, lacking, parts, training, topics)},
    )
    write_classifier(model, out)
    _tell(model, samples, crossed)


def _pairs(items: list[str]) -> list[tuple[str, str]]:
    pairs = []
    for item in items:
        drive, equals, pole_map = item.rpartition("=")
        if not equals or not drive or not pole_map:
            raise ConfigError(f"{item}: expected DRIVE=MAP, such as sim_1=sim_1/objects.geojson")
        pairs.append((drive, pole_map))
    return pairs


def _source(
    pairs: list[tuple[str, str]],
    lacking: dict[str, str],
    parts: int,
    training: TrainingConfig,
    topics: Path | None,
) -> dict[str, Any]:
    """The command, without the folders of this machine, and what the drives say of themselves."""
    words = [f"{Path(drive).name}={Path(pole_map).name}" for drive, pole_map in pairs]
    words += [f"--unmapped {Path(d).name}={Path(m).name}" for d, m in lacking.items()]
    opened = [open_drive(Path(drive), topics=topics) for drive, _ in pairs]
    return {
        "command": f"polemap train {' '.join(words)} --parts {parts} --every {training.every}"
        + (f" --kind {training.kind}" if training.kind != "pole" else ""),
        "notes": {drive.name: list(drive.notes) for drive in opened},
    }


def _collect(
    path: str,
    pole_map: str,
    lacking: str | None,
    settings: Settings,
    training: TrainingConfig,
    parts: int,
    topics: Path | None,
) -> Samples:
    drive = open_drive(Path(path), topics=topics)
    known = read_map(Path(pole_map), drive.frame)
    ignore = read_map(Path(lacking), drive.frame).points_m if lacking else None
    matcher = make_matcher(settings.stereo, drive.rig)
    with progress(len(drive.frame_stamps_s), f"hypotheses of {drive.name}") as advance:
        return collect(
            drive,
            known,
            matcher,
            settings.polemap.detection,
            training,
            ignore_m=ignore,
            parts=parts,
            progress=advance,
        )


def _origin(
    samples: Samples, crossed: Judgement | None, training: TrainingConfig
) -> dict[str, Any]:
    origin: dict[str, Any] = {
        "version": __version__,
        "drives": list(samples.groups),
        "poles": int(np.count_nonzero(samples.is_pole)),
        "others": int(np.count_nonzero(~samples.is_pole)),
        "seed": "none drawn: the fit is deterministic",
        "inverse_penalty": training.inverse_penalty,
        "pole_within_m": training.pole_within_m,
        "other_beyond_m": training.other_beyond_m,
    }
    if crossed is not None:
        origin["cross_validated"] = _figures(crossed)
    return origin


def _figures(judgement: Judgement) -> dict[str, Any]:
    return {
        "average_precision": round(judgement.average_precision, 4),
        "brier": round(judgement.brier, 4),
        "reliability": [
            {"probability": round(p, 3), "poles": round(share, 3), "count": int(count)}
            for p, share, count in judgement.reliability.tolist()
        ],
    }


def _tell(model: PoleClassifier, samples: Samples, crossed: Judgement | None) -> None:
    """The result as one JSON document on stdout."""
    order = np.argsort(-np.abs(model.weights))
    report: dict[str, Any] = {
        "samples": {
            name: {
                "poles": int(np.count_nonzero(samples.is_pole & (samples.group == row))),
                "others": int(np.count_nonzero(~samples.is_pole & (samples.group == row))),
            }
            for row, name in enumerate(samples.groups)
        },
        "cross_validated": _figures(crossed) if crossed else None,
        "weights": {model.names[i]: round(float(model.weights[i]), 3) for i in order},
    }
    if crossed is not None:
        at = np.linspace(0, len(crossed.threshold) - 1, 12).astype(int)
        report["precision_recall"] = [
            [round(float(v[i]), 3) for v in (crossed.threshold, crossed.precision, crossed.recall)]
            for i in at
        ]
    sys.stdout.write(json.dumps(report, indent=1) + "\n")
