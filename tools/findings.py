"""Findings of the plausibility checks on the screen: one line each, and errors refuse."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding

_LINE_MAX = 240


def require_plausible(name: str, found: Sequence[Finding], *, force: bool) -> None:
    """Print findings on stderr, one line each; errors refuse, in one line alone, unless forced.

    Raises:
        InputError: a finding of severity `error`, and no `--force`.
    """
    errors = [finding for finding in found if finding.severity == "error"]
    if errors and not force:
        more = f", {len(found) - 1} more in polemap info" if len(found) > 1 else ""
        raise InputError(_short(f"{name}: {errors[0].line()}") + f" (--force goes on{more})")
    for finding in found:
        line = f"{finding.severity}: {name}: {finding.line()}"
        sys.stderr.write(f"polemap: {_short(line)}\n")


def _short(line: str) -> str:
    line = " ".join(line.split())
    return line if len(line) <= _LINE_MAX else line[: _LINE_MAX - 1] + "…"
