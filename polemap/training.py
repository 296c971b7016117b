"""Training the classifier on drives with a known pole map, and judging it across drives.

The map is moved into every frame by the reference pose. A hypothesis near a mapped pole is a
pole, one far from all is not, and what lies between is not used: maps scatter. The figures come
from models that never saw the drive (or the half of it) on which they are judged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polemap.build.offset_from_map import offset_from_map
from polemap.detect import corner_features
from polemap.detect import features as pole_features
from polemap.detect.classifier import PoleClassifier, fit_classifier
from polemap.detect.config import DetectionConfig, KindName
from polemap.detect.detection import detect
from polemap.drivelog.columns import Columns
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import FrameError, InputError
from polemap.map.pole_map import PoleMap
from polemap.stereo.matching import StereoMatcher
from polemap.track.disparity_offset import with_disparity
from polemap.vehicle.pose import transform_points

Floats = NDArray[np.float64]

FEATURES: Mapping[KindName, tuple[str, ...]] = {
    "pole": pole_features.NAMES,
    "corner": corner_features.NAMES,
}


@dataclass(frozen=True, slots=True)
class TrainingConfig:
    """How hypotheses are labelled and the model is fitted.

    Attributes:
        pole_within_m: nearer to a mapped pole is a pole; grows by `per_range` of the range.
        other_beyond_m: farther from all of them is not a pole.
        per_range: for the error of the range.
        range_max_m: what lies farther is not used: neither its place nor a map's is sure enough.
        inverse_penalty: of the logistic regression.
        every: only every n-th frame is used: neighbours are alike.
        kind: of what is learned; where it is corners, poles stand for corners above.
    """

    pole_within_m: float = 0.55
    other_beyond_m: float = 1.1
    per_range: float = 0.015
    range_max_m: float = 25.0
    inverse_penalty: float = 0.07
    every: int = 1
    kind: KindName = "pole"


@dataclass(frozen=True, slots=True)
class Samples(Columns):
    """Labelled hypotheses, one a row.

    Attributes:
        features: `(n, k)`.
        is_pole: `(n,)`.
        group: `(n,)` number of the drive, or of the part of it, that they come from.
        pole: `(n,)` row of the mapped pole, -1 for other things.
        groups: names of the groups.
    """

    HEADER: ClassVar[frozenset[str]] = frozenset({"groups"})

    features: Floats
    is_pole: NDArray[np.bool_]
    group: NDArray[np.int64]
    pole: NDArray[np.int64]
    groups: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Judgement:
    """How well probabilities fit labels.

    Attributes:
        average_precision: area under the precision-recall curve.
        brier: mean squared error of the probability.
        precision, recall, threshold: the curve.
        reliability: rows `(mean probability, share of poles, count)` by bin of probability.
    """

    average_precision: float
    brier: float
    precision: Floats = field(repr=False)
    recall: Floats = field(repr=False)
    threshold: Floats = field(repr=False)
    reliability: Floats = field(repr=False)


class _Observed(NamedTuple):
    """Hypotheses of one frame: pose `(3,)` of the car, points `(n, 2)`, features `(n, k)`, part."""

    pose: Floats
    points_vehicle_m: Floats
    features: Floats
    part: int


def collect(
    drive: Drive,
    pole_map: PoleMap,
    matcher: StereoMatcher,
    detection: DetectionConfig,
    config: TrainingConfig,
    *,
    ignore_m: Floats | None = None,
    parts: int = 1,
    progress: Callable[[int], None] | None = None,
) -> Samples:
    """Labelled hypotheses of a drive.

    Args:
        drive: with images and a reference.
        pole_map: known poles, in the drive's frame.
        matcher: for the disparity.
        detection: how hypotheses are found.
        config: how they are labelled.
        ignore_m: `(m, 2)` places of true poles that the map lacks; what lies there is not used.
        parts: into how many stretches of equal length the drive is cut for cross-validation.
        progress: is called with 1 after every frame.

    Raises:
        FrameError: drive and map are in different frames.
        InputError: the drive lacks images or a reference.
    """
    if pole_map.frame != drive.frame:
        raise FrameError(
            f"training: drive {drive.name} is in {drive.frame}, the map in {pole_map.frame}"
        )
    if drive.rig is None or not drive.has_frames or drive.reference is None:
        raise InputError(f"training: drive {drive.name} needs images and a reference")
    poses = drive.reference.at(drive.frame_stamps_s)
    observed = []
    sought = detection.model_copy(update={"kinds": tuple({"pole": None, config.kind: None})})
    for row in range(0, len(poses), config.every):
        if not np.isfinite(poses[row]).all():
            continue
        frame = drive.read_frame(row)
        disparity = matcher.match(frame.left, frame.right)
        shown = detect(frame, disparity, drive.rig, None, sought)
        found = shown.detections if shown.corners is None else shown.corners
        part = row * parts // len(poses)
        observed.append(_Observed(poses[row], found.points_vehicle_m, found.features, part))
        if progress is not None:
            progress(config.every)
    # a camera out of true puts far poles beside the map's, which would be taken for other things
    offset_px = offset_from_map([one[:2] for one in observed], pole_map, drive.rig)
    features, labels, groups, poles = [], [], [], []
    for one in observed:
        seen = one.points_vehicle_m
        points = transform_points(one.pose, with_disparity(seen, offset_px, drive.rig))
        use, pole = _labelled(points, np.hypot(*seen.T), pole_map.points_m, config, ignore_m)
        features.append(one.features[use])
        labels.append(pole[use] >= 0)
        groups.append(np.full(np.count_nonzero(use), one.part))
        poles.append(pole[use])
    names = tuple(f"{drive.name}[{part + 1}/{parts}]" for part in range(parts))
    return Samples(
        np.concatenate(features) if features else np.empty((0, len(FEATURES[config.kind]))),
        np.concatenate(labels) if labels else np.empty(0, dtype=bool),
        np.concatenate(groups) if groups else np.empty(0, dtype=np.int64),
        np.concatenate(poles) if poles else np.empty(0, dtype=np.int64),
        names if parts > 1 else (drive.name,),
    )


def join(samples: Sequence[Samples]) -> Samples:
    """Samples of several drives, their groups numbered on."""
    first = np.cumsum([0, *(len(s.groups) for s in samples)])
    shifted = [
        s.with_columns(group=s.group + shift) for s, shift in zip(samples, first, strict=False)
    ]
    groups = tuple(name for s in samples for name in s.groups)
    return replace(Samples.concatenate(shifted), groups=groups)


def train(samples: Samples, config: TrainingConfig, origin: Mapping[str, Any]) -> PoleClassifier:
    """Fit a classifier in which every drive has the same say.

    Raises:
        InputError: labels of one kind only.
    """
    if not len(samples):
        raise InputError("training: no labelled hypotheses; do the maps lie along the drives?")
    counts = np.bincount(samples.group, minlength=len(samples.groups)).astype(np.float64)
    # between one say a sample and one say a drive
    weight = 1.0 / np.sqrt(counts[samples.group])
    return fit_classifier(
        samples.features,
        samples.is_pole,
        weight,
        names=FEATURES[config.kind],
        inverse_penalty=config.inverse_penalty,
        origin=origin,
    )


def cross_validate(samples: Samples, config: TrainingConfig) -> Floats:
    """Probability `(n,)` of every sample by a model that did not see its group.

    Raises:
        InputError: there is one group only, or a fold lacks poles or other things.
    """
    if len(samples.groups) < 2:
        raise InputError("training: cross-validation needs two drives, or --parts 2 or more")
    probability = np.full(len(samples), np.nan)
    for group in range(len(samples.groups)):
        held = samples.group == group
        if held.any():
            model = train(samples.take(~held), config, {})
            probability[held] = model.probability(samples.features[held])
    return probability


def judge(probability: Floats, is_pole: NDArray[np.bool_], bins: int = 10) -> Judgement:
    """Precision-recall curve, Brier score and reliability.

    Raises:
        InputError: labels of one kind only.
    """
    from sklearn.metrics import average_precision_score, precision_recall_curve

    if not is_pole.any() or is_pole.all():
        raise InputError(f"training: {len(is_pole)} labels of one kind cannot be judged")
    precision, recall, threshold = precision_recall_curve(is_pole, probability)
    place = np.clip((probability * bins).astype(np.int64), 0, bins - 1)
    count = np.bincount(place, minlength=bins).astype(np.float64)
    safe = np.maximum(count, 1.0)
    reliability = np.stack(
        [
            np.bincount(place, weights=probability, minlength=bins) / safe,
            np.bincount(place, weights=is_pole.astype(np.float64), minlength=bins) / safe,
            count,
        ],
        axis=1,
    )
    return Judgement(
        float(average_precision_score(is_pole, probability)),
        float(np.mean((probability - is_pole) ** 2)),
        precision,
        recall,
        threshold,
        reliability[count > 0],
    )


def _labelled(
    points_m: Floats,
    range_m: Floats,
    poles_m: Floats,
    config: TrainingConfig,
    ignore_m: Floats | None,
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which hypotheses `(n,)` can be labelled, and the map pole of each, -1 for other things."""
    slack = config.per_range * range_m
    nearest, distance = _nearest(points_m, poles_m)
    is_pole = distance <= config.pole_within_m + slack
    is_other = distance >= config.other_beyond_m + slack
    if ignore_m is not None and len(ignore_m):
        is_other &= _nearest(points_m, ignore_m)[1] > config.other_beyond_m + slack
    use = (is_pole | is_other) & (range_m <= config.range_max_m)
    return use, np.where(is_pole, nearest, -1)


def _nearest(points_m: Floats, others_m: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Row of and distance to the nearest of `others_m` for every point."""
    if not len(points_m) or not len(others_m):
        return np.full(len(points_m), -1), np.full(len(points_m), np.inf)
    distance = np.hypot(*np.moveaxis(points_m[:, None] - others_m, 2, 0))
    nearest = distance.argmin(axis=1)
    return nearest, distance[np.arange(len(points_m)), nearest]
