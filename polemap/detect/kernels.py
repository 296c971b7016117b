"""The C++ kernels of the detector; where none was built the plain way serves, and says so once."""

from __future__ import annotations

import warnings
from functools import cache
from importlib import import_module
from typing import Any


@cache
def kernel(name: str) -> Any | None:
    """The kernel `name` of `polemap.detect.native`, or None where it was not built."""
    try:
        return import_module(f"polemap.detect.native.{name}")
    except ImportError:
        warnings.warn(
            f"the C++ kernel {name} is not built here: numpy does its work, alike but slower; "
            "install a C++17 compiler and run `make setup`",
            RuntimeWarning,
            stacklevel=2,
        )
        return None
