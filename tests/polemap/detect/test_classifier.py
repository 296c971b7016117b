"""The classifier, its file, and the training figures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from polemap.detect.classifier import PoleClassifier, fit_classifier
from polemap.detect.features import NAMES
from polemap.detect.models.io import read_classifier, write_classifier
from polemap.drivelog.errors import InputError
from polemap.training import Samples, TrainingConfig, cross_validate, join, judge, train


def _samples(seed: int, count: int = 300, group: str = "drive") -> Samples:
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((count, len(NAMES)))
    weights = np.zeros(len(NAMES))
    weights[:4] = (2.0, -1.5, 1.0, 0.5)
    is_pole = rng.random(count) < 1 / (1 + np.exp(-features @ weights))
    pole = np.where(is_pole, 0, -1)
    return Samples(features, is_pole, np.zeros(count, dtype=np.int64), pole, (group,))


def test_fit_equals_scikit_learn() -> None:
    data = _samples(1)
    model = train(data, TrainingConfig(inverse_penalty=0.3), {})
    oracle = make_pipeline(StandardScaler(), LogisticRegression(C=0.3, max_iter=2000, tol=1e-8))
    oracle.fit(data.features, data.is_pole)
    expected = oracle.predict_proba(data.features)[:, 1]
    assert np.allclose(model.probability(data.features), expected, atol=2e-3)


def test_one_kind_of_label_is_refused() -> None:
    with pytest.raises(InputError, match="all 5 labelled hypotheses are poles"):
        fit_classifier(
            np.ones((5, 2)), np.ones(5, dtype=bool), np.ones(5),
            names=("a", "b"), inverse_penalty=1.0, origin={},
        )  # fmt: skip
    empty = np.empty(0, dtype=np.int64)
    none = Samples(np.empty((0, len(NAMES))), empty.astype(bool), empty, empty, ("d",))
    with pytest.raises(InputError, match="no labelled hypotheses"):
        train(none, TrainingConfig(), {})


def test_an_extreme_feature_cannot_decide_alone() -> None:
    model = PoleClassifier(("a",), np.zeros(1), np.ones(1), np.ones(1), 0.0, {})
    assert model.logits(np.array([[1e6]]))[0] == model.logits(np.array([[100.0]]))[0]
    with pytest.raises(InputError, match="mean has shape"):
        PoleClassifier(("a",), np.zeros(2), np.ones(1), np.ones(1), 0.0, {})
    with pytest.raises(InputError, match="not finite"):
        PoleClassifier(("a",), np.array([np.nan]), np.ones(1), np.ones(1), 0.0, {})
    with pytest.raises(InputError, match="scale is not positive"):
        PoleClassifier(("a",), np.zeros(1), np.zeros(1), np.ones(1), 0.0, {})


def test_file_round_trip_keeps_every_probability(tmp_path: Path) -> None:
    data = _samples(2)
    model = train(data, TrainingConfig(), {"drives": ["a"], "seed": 3})
    write_classifier(model, tmp_path / "model.json")
    again = read_classifier(str(tmp_path / "model.json"))
    assert np.array_equal(again.probability(data.features), model.probability(data.features))
    assert again.origin == model.origin
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]


def test_built_in_model_names_its_origin() -> None:
    model = read_classifier("default")
    assert model.names == NAMES
    assert {"drives", "version", "poles", "others"} <= set(model.origin)


def test_files_that_are_no_model_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    with pytest.raises(InputError, match=r"no such classifier .*built in: .*default"):
        read_classifier(str(path))
    path.write_text("{nothing")
    with pytest.raises(InputError, match="not JSON"):
        read_classifier(str(path))
    path.write_text("[]")
    with pytest.raises(InputError, match="is not a 'polemap pole classifier' file"):
        read_classifier(str(path))
    write_classifier(train(_samples(1), TrainingConfig(), {}), path)
    good = json.loads(path.read_text())
    for change, complaint in (
        ({"format_version": 9}, "format_version 9"),
        ({"bias": "much"}, "missing or not a number"),
        ({"features": good["features"][1:]}, "trained on other features"),
        ({"features": good["features"][::-1]}, "their order"),
    ):
        path.write_text(json.dumps({**good, **change}))
        with pytest.raises(InputError, match=complaint):
            read_classifier(str(path))
    good["features"][0]["scale"] = 0.0
    path.write_text(json.dumps(good))
    with pytest.raises(InputError, match=r"model\.json: .*scale is not positive"):
        read_classifier(str(path))


def test_cross_validation_never_sees_the_group_that_it_judges() -> None:
    one, two = _samples(1, group="one"), _samples(2, group="two")
    both = join([one, two])
    probability = cross_validate(both, TrainingConfig())
    alone = train(one, TrainingConfig(), {}).probability(two.features)
    assert np.allclose(probability[len(one) :], alone)
    with pytest.raises(InputError, match="two drives"):
        cross_validate(one, TrainingConfig())


def test_judgement_of_calibrated_and_of_useless_probabilities() -> None:
    rng = np.random.default_rng(4)
    truth = rng.random(20000)
    labels = rng.random(20000) < truth
    good = judge(truth, labels)
    # Brier score of a calibrated forecast, p uniform: E p (1 - p) = 1/6; 5 sd of the mean
    assert abs(good.brier - 1 / 6) < 5 * 0.15 / np.sqrt(20000)
    for mean, share, count in good.reliability:
        assert abs(mean - share) < 5 * np.sqrt(0.25 / count)
    useless = judge(rng.random(20000), labels)
    assert useless.average_precision < 0.53 < good.average_precision
    with pytest.raises(InputError, match="one kind"):
        judge(truth, np.ones(20000, dtype=bool))
