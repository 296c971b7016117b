"""A disturbance observer on any estimate: what moves the car that the nominal model does not say.

For controllers that reject disturbances behind an estimator that has none among its states.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.errors import VehicleError

Floats = NDArray[np.float64]


class DisturbanceObserver:
    """d = low-pass(x' - A x - B u) of an estimate x, realised without differentiating.

    z' = A x + B u + d with d = g (x - z): d follows the true disturbance as a low-pass of cut-off
    g. What the estimate does not show, because its filter believes the model, is not found.

    Source: disturbance observer of N13 ref. (16), applied to the planar model (N13 (17), (30)).
    """

    def __init__(self, cutoff_radps: float) -> None:
        if not cutoff_radps > 0.0:
            raise VehicleError(f"disturbance observer: cut-off is {cutoff_radps}, not positive")
        self._cutoff_radps = cutoff_radps
        self._model: Floats | None = None

    def step(self, a: Floats, b: Floats, estimate: Floats, inputs: Floats, dt_s: float) -> Floats:
        """Disturbance `(n,)` per second.

        Args:
            a: `(n, n)` and
            b: `(n, m)`: nominal model.
            estimate: `(n,)` of now.
            inputs: `(m,)` that were applied over the last `dt_s`.
        """
        if self._model is None:
            self._model = estimate.copy()
        found = self._cutoff_radps * (estimate - self._model)
        self._model = self._model + dt_s * (a @ estimate + b @ inputs + found)
        return np.asarray(found)
