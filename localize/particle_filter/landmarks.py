"""What a scan's poles are held against: the map's poles as arrays, and how the two relate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.map.landmark_map import PoleMap

Floats = NDArray[np.float64]

_LARGEST_DETECTION = 0.999


@dataclass(frozen=True, slots=True)
class PoleModel:
    """How seen poles relate to map poles.

    Attributes:
        beta_p: weight of the position term against the width term.
        width_sd_m: expected deviation of a seen width from the mapped one.
        clutter_per_m2: intensity of the Poisson process of false poles, on the ground.
        clutter_width_span_m: false poles are as likely at any width within this span.
        position_floor_m: standard deviation added to every scan position; what the detector's
            own covariance does not know (calibration, a trunk that is no line).
    """

    beta_p: float = 1.0
    width_sd_m: float = 0.15
    clutter_per_m2: float = 1e-3
    clutter_width_span_m: float = 1.0
    position_floor_m: float = 0.05

    @property
    def log_width_gain(self) -> float:
        """Log ratio of the width densities of a right pair at zero error and of clutter."""
        return float(np.log(self.clutter_width_span_m / (np.sqrt(2 * np.pi) * self.width_sd_m)))


@dataclass(frozen=True, slots=True)
class Landmarks:
    """The map poles around the car, as plain arrays.

    Attributes:
        points_m: `(m, 2)` east, north.
        covariance_m2: `(m, 3)` var east, var north, covariance.
        width_m: `(m,)`, NaN where unknown.
        detection: `(m,)` probability that a pole in view is reported, in (0, 1).
        rows: `(m,)` rows of the map that they come from.
    """

    points_m: Floats
    covariance_m2: Floats
    width_m: Floats
    detection: Floats
    rows: NDArray[np.int64]

    @classmethod
    def of(
        cls, pole_map: PoleMap, p_detection: float, rows: NDArray[np.int64] | None = None
    ) -> Landmarks:
        """Some poles of a map, or all; one that may no longer stand is expected less."""
        if rows is None:
            rows = np.arange(len(pole_map))
        covariance = pole_map.covariance_m2.reshape(-1, 2, 2)[rows]
        existence = np.clip(pole_map.existence[rows], 0.05, 1.0)
        return cls(
            np.ascontiguousarray(pole_map.points_m.reshape(-1, 2)[rows]),
            np.stack([covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]], axis=1),
            np.asarray(pole_map.width_m[rows], dtype=np.float64),
            np.minimum(p_detection * existence, _LARGEST_DETECTION),
            rows,
        )

    def __len__(self) -> int:
        return len(self.rows)
