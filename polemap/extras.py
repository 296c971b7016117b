"""What only some installs have: packages of extras, and kernels that a compiler has built."""

from __future__ import annotations

import warnings
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from polemap.errors import PolemapError

# module: extra of pyproject.toml that brings it
EXTRA_OF = {
    "open3d": "simulate",
    "libusb_package": "simulate",
    "control": "simulate",
    "matplotlib": "report",
    "jinja2": "report",
    "dask": "city",
    "distributed": "city",
    "osmium": "gis",
    "pyarrow": "gis",
    "mcap": "bags",
    "mcap_protobuf": "bags",
    "mcap_ros2": "bags",
    "rosbags": "bags",
    "lz4": "bags",
    "zstandard": "bags",
    "rerun": "viewer",
    "websockets": "viewer",
    "gtsam": "slam",
}


class MissingExtraError(PolemapError, ImportError):
    """A package that this work needs and that no base install has; the message installs it."""


def need(module: str) -> Any:
    """A module of an extra.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        missing = missing_extra(error)
        if missing is None:
            raise
        raise missing from error


def check_installed(module: str) -> None:
    """`need` before the work begins, without the time that importing takes.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        if find_spec(module) is not None:
            return
    except ModuleNotFoundError:
        pass
    missing = missing_extra(ModuleNotFoundError(f"No module named {module!r}", name=module))
    if missing is not None:
        raise missing


def missing_extra(error: ModuleNotFoundError) -> MissingExtraError | None:
    """What to say of a module that was not found; None if no extra would bring it."""
    top = (error.name or "").partition(".")[0]
    extra = EXTRA_OF.get(top)
    if extra is None:
        return None
    return MissingExtraError(
        f"this needs {top}, which is not installed: pip install 'polemap[{extra}]'"
    )


@cache
def kernel(module: str) -> Any | None:
    """A C++ kernel, or None where it was not built, which is said once: the plain way serves."""
    try:
        return import_module(module)
    except ImportError:
        warnings.warn(
            f"the C++ kernel {module.rpartition('.')[2]} is not built here: Python does its work, "
            "alike but slower; install a C++17 compiler and run `make setup`",
            RuntimeWarning,
            stacklevel=2,
        )
        return None
