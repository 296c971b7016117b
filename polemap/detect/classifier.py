"""Is a hypothesis a pole? Logistic regression on standardised features."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError

Floats = NDArray[np.float64]

_CLIP_SIGMA = 4.0  # a feature far outside of what was trained on must not decide alone


@dataclass(frozen=True, slots=True)
class PoleClassifier:
    """p = 1 / (1 + exp(-(w . (x - mean) / scale + bias))).

    Attributes:
        names: `k` names of the features.
        mean, scale, weights: `(k,)`.
        bias: intercept.
        origin: what it was trained on: data, seed, version, counts, figures.

    Raises:
        InputError: arrays of another length than the names, or a value that cannot be used.
    """

    names: tuple[str, ...]
    mean: Floats
    scale: Floats
    weights: Floats
    bias: float
    origin: Mapping[str, Any]

    def __post_init__(self) -> None:
        for field in ("mean", "scale", "weights"):
            values = getattr(self, field)
            if values.shape != (len(self.names),):
                raise InputError(
                    f"pole classifier: {field} has shape {values.shape} for {len(self.names)} names"
                )
            if not np.isfinite(values).all():
                raise InputError(f"pole classifier: {field} holds a value that is not finite")
        if not (self.scale > 0).all() or not np.isfinite(self.bias):
            raise InputError("pole classifier: a scale is not positive or the bias is not finite")

    def logits(self, features: Floats) -> Floats:
        """Log-odds of `(n, k)` features; `(n,)`."""
        standard = np.clip((features - self.mean) / self.scale, -_CLIP_SIGMA, _CLIP_SIGMA)
        return np.asarray(standard @ self.weights + self.bias)

    def probability(self, features: Floats) -> Floats:
        """Probability of being a pole for `(n, k)` features; `(n,)`."""
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(self.logits(features), -40.0, 40.0))))


def fit_classifier(
    features: Floats,
    is_pole: NDArray[np.bool_],
    weight: Floats,
    *,
    names: tuple[str, ...],
    inverse_penalty: float,
    origin: Mapping[str, Any],
) -> PoleClassifier:
    """Weighted logistic regression with an L2 penalty, after standardisation.

    Args:
        features: `(n, k)`.
        is_pole: `(n,)` labels.
        weight: `(n,)` of every sample.
        names: of the k features.
        inverse_penalty: C of scikit-learn, at weights that average one.
        origin: is stored with the model.

    Raises:
        InputError: labels of one kind only.
    """
    from sklearn.linear_model import LogisticRegression  # slow to import, rarely needed

    if is_pole.all() or not is_pole.any():
        kind = "poles" if is_pole.all() else "other things"
        raise InputError(f"training: all {len(is_pole)} labelled hypotheses are {kind}; add drives")
    share = weight / weight.sum()
    mean = share @ features
    scale = np.sqrt(share @ (features - mean) ** 2)
    scale = np.where(scale > 1e-6, scale, 1.0)
    standard = np.clip((features - mean) / scale, -_CLIP_SIGMA, _CLIP_SIGMA)
    model = LogisticRegression(C=inverse_penalty, max_iter=2000, tol=1e-6)
    model.fit(standard, is_pole, sample_weight=weight / weight.mean())
    return PoleClassifier(
        names, mean, scale, model.coef_[0].astype(np.float64), float(model.intercept_[0]), origin
    )
