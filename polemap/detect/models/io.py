"""Pole classifiers on disk: JSON that a person can read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from polemap.detect import corner_features
from polemap.detect.classifier import PoleClassifier
from polemap.detect.features import NAMES
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import InputError
from polemap.parsing.errors import named, short
from polemap.parsing.json_text import read_json
from polemap.parsing.text import MEGABYTE

_FORMAT = "polemap pole classifier"
_VERSION = 1


def read_corner_classifier(name_or_path: str) -> PoleClassifier:
    """`read_classifier` of a model that was made for the features of corners."""
    return read_classifier(name_or_path, corner_features.NAMES)


def read_classifier(name_or_path: str, features: tuple[str, ...] = NAMES) -> PoleClassifier:
    """A built-in classifier by its name, or one from a JSON file.

    Args:
        features: names of those that it must have been made for.

    Raises:
        InputError: no such model, not JSON, or made for other features.
    """
    path = Path(name_or_path)
    if path.suffix != ".json" and path.name == name_or_path:
        path = Path(__file__).parent / f"{name_or_path}.json"
    if not path.is_file():
        built_in = sorted(p.stem for p in Path(__file__).parent.glob("*.json"))
        raise InputError(f"{path}: no such classifier file; built in: {', '.join(built_in)}")
    with named(path, InputError, "classifier"):
        tree = read_json(path, 10 * MEGABYTE)
    if not isinstance(tree, dict) or tree.get("format") != _FORMAT:
        raise InputError(f"{path}: is not a '{_FORMAT}' file")
    if tree.get("format_version") != _VERSION:
        raise InputError(f"{path}: format_version {tree.get('format_version')}, not {_VERSION}")
    try:
        rows = tree["features"]
        names = tuple(str(row["name"]) for row in rows)
        mean, scale, weights = (
            np.array([float(row[key]) for row in rows]) for key in ("mean", "scale", "weight")
        )
        bias, origin = float(tree["bias"]), dict(tree["origin"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: a value is missing or not a number ({short(error)})") from error
    if names != features:
        strange = sorted(set(names) ^ set(features)) or ["their order"]
        raise InputError(
            f"{path}: was trained on other features ({', '.join(strange[:5])}); "
            "train it again with `polemap train`"
        )
    try:
        return PoleClassifier(names, mean, scale, weights, bias, origin)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def write_classifier(model: PoleClassifier, path: Path) -> None:
    """Write the model, whole or not at all.

    Raises:
        InputError: the place cannot be written to.
    """
    rows = [
        {"name": n, "mean": float(m), "scale": float(s), "weight": float(w)}
        for n, m, s, w in zip(model.names, model.mean, model.scale, model.weights, strict=True)
    ]
    tree = {
        "format": _FORMAT,
        "format_version": _VERSION,
        "origin": dict(model.origin),
        "bias": model.bias,
        "features": rows,
    }
    with atomic_file(Path(path)) as part:
        part.write_text(json.dumps(tree, indent=1) + "\n", encoding="utf-8")
