"""Inputs held against each other before work begins, as the commands do it."""

from __future__ import annotations

import logging
import warnings

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding, Severity
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.tools.findings import require_plausible
from polemap.tools.plausible import find

_LOG = logging.getLogger("polemap")

# the last inputs that were looked at: a replay with a hundred seeds looks once
_Checked = tuple[Drive, PoleMap | CityMap | None, list[Finding]]
_last: list[_Checked] = []


def check(drive: Drive, pole_map: PoleMap | CityMap | None = None, *, force: bool) -> None:
    """Refuse what makes a result worthless, warn of what makes it doubtful.

    Raises:
        InputError: a finding of severity `error`, and not `force`.
    """
    found = next((f for d, m, f in _last if d is drive and m is pole_map), None)
    known = found is not None
    if found is None:
        found = find(drive, pole_map)
        _last[:] = [(drive, pole_map, found)]

    def say(severity: Severity, line: str) -> None:
        # the warnings of inputs that were looked at before have been given
        if severity == "note" or known:
            _LOG.info(line)
        else:
            # in the name of who called the public function
            warnings.warn(line, stacklevel=5)

    require_plausible(drive.name, found, force=force, say=say, way_on="force=True")
