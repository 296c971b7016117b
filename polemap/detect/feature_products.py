"""Combinations of features: what a straight line through single features cannot tell.

A logistic regression weighs every feature for itself. But a low top speaks against a pole, unless
the thing is thin and free all around (a bollard), so every feature weighs anew for low things; a
width of half a metre is a trunk's, unless the top is as high as a person. Such combinations are
features of their own.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_BOLLARD_M = (0.8, 1.5)  # a top below the first is low, above the second it is not
_PERSON_M, _PERSON_SD_M = 1.75, 0.2

_LOW = "low_"  # times low: what a feature says of low things
NAMES = (
    "low",  # 1 with a top as low as a bollard's, 0 for what is taller
    "person",  # 1 with a top as high as a person
    "person_width",
    "person_width_scatter",
    "log_width",
    "top_square",
    "free_on",  # free_both times on_share
    "on_square",
    "wobble_range",  # what grows with the noise of far disparities
    "depth_scatter_range",
    "width_range",
    "free_range",
    "above_free_both",  # free above and on both sides
)


def products(of: Mapping[str, Floats]) -> dict[str, Floats]:
    """The combinations, from single features by name, `(n,)` each."""
    top, width, on, free = of["top_m"], of["width_m"], of["on_share"], of["free_both"]
    range_m = of["range_m"]
    low = np.clip((_BOLLARD_M[1] - top) / (_BOLLARD_M[1] - _BOLLARD_M[0]), 0.0, 1.0)
    person = np.exp(-0.5 * ((top - _PERSON_M) / _PERSON_SD_M) ** 2)
    values = (
        low, person, person * width, person * of["width_scatter"],
        np.log(width + 0.03), top**2, free * on, on**2,
        of["wobble"] * range_m, of["depth_scatter"] * range_m, width * range_m, free * range_m,
        of["above_free"] * free,
    )  # fmt: skip
    lows = {f"{_LOW}{name}": low * value for name, value in of.items()}
    return {**dict(zip(NAMES, values, strict=True)), **lows}


def names(of: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the combinations of the named single features, in the order of `products`."""
    return (*NAMES, *(f"{_LOW}{name}" for name in of))
