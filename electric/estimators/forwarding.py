"""An estimator around another: what does not concern it goes through."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.electric.estimators.base import Estimate, Estimator

Floats = NDArray[np.float64]


class Forwarding:
    """Says of itself what the estimator inside says.

    Attributes:
        dropped: the same dict as the estimator's.
    """

    def __init__(self, inner: Estimator) -> None:
        self._inner = inner
        self.dropped = inner.dropped

    @property
    def fields(self) -> tuple[str, ...]:
        """The estimator's."""
        return self._inner.fields

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def estimate(self) -> Estimate:
        """The state of now."""
        return self._inner.estimate()

    def covariance(self) -> Floats:
        """`(n, n)` of the fields."""
        return self._inner.covariance()
