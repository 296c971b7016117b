"""The C++ kernel of the particles, or None where none was built: numpy then does its work."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def _built() -> Any | None:
    try:
        return import_module("polemap.localize.particle_filter.native.particle_kernel")
    except ImportError:
        return None


particle_kernel = _built()
