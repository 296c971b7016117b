"""Plug-ins of installed packages: readers, matchers and estimators, found by entry points.

A plug-in that cannot be loaded is one line of warning and takes nothing else down; asked for by
name, it is an error. None may take the name of one of polemap's own.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from polemap.errors import PolemapError

READERS, MATCHERS, ESTIMATORS = "polemap.readers", "polemap.matchers", "polemap.estimators"
_OURS = "polemap."
_SHOWN = 120


class PluginError(PolemapError):
    """An installed plug-in that cannot be loaded or is not what it says it is."""


@cache
def installed(group: str) -> Mapping[str, EntryPoint]:
    """Entry points of other packages by name, none of them loaded."""
    points = entry_points(group=group)
    return {point.name: point for point in points if not point.value.startswith(_OURS)}


def load_plugin(point: EntryPoint, members: Collection[str]) -> Any:
    """What an entry point leads to.

    Args:
        point: of one of the groups.
        members: attributes that it must have.

    Raises:
        PluginError: it cannot be imported, or lacks a member.
    """
    try:
        found = point.load()
    except (Exception, SystemExit) as error:
        raise PluginError(
            f"{_named(point)} cannot be loaded ({short(error)}); {_REMEDY}"
        ) from error
    missing = [name for name in members if not hasattr(found, name)]
    if missing:
        raise PluginError(
            f"{_named(point)} has no {' and no '.join(missing)}; docs/plugins.md has a template"
        )
    return found


_REMEDY = "mend, update or uninstall its package"


@cache
def load_plugins(group: str, members: tuple[str, ...], ours: frozenset[str]) -> Mapping[str, Any]:
    """All plug-ins of a group by name, but for those that cannot be used, which are warned of.

    Args:
        group: one of the groups above.
        members: attributes that each must have.
        ours: names that are taken.
    """
    found = {}
    for name, point in sorted(installed(group).items()):
        if name in ours:
            warnings.warn(
                f"{_named(point)} is called as one of polemap's own and is not used", stacklevel=2
            )
            continue
        try:
            found[name] = load_plugin(point, members)
        except PluginError as error:
            warnings.warn(f"{error} (it is left out)", stacklevel=2)
    return found


def short(error: BaseException) -> str:
    """What went wrong in somebody else's code, on one line."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


def _named(point: EntryPoint) -> str:
    package = f" of package {point.dist.name}" if point.dist is not None else ""
    return f"plug-in '{point.name}'{package} ({point.group})"
