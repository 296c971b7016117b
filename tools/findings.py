"""Findings of the plausibility checks on the screen: one line each, and errors refuse."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding

_LINE_MAX = 280


def require_plausible(name: str, found: Sequence[Finding], *, force: bool) -> None:
    """Print findings on stderr, one line each; refuse to go on with errors unless forced.

    Raises:
        InputError: a finding of severity `error`, and no `--force`.
    """
    errors = [finding for finding in found if finding.severity == "error"]
    refused = errors[:1] if not force else []
    for finding in found:
        if finding not in refused:
            line = f"{finding.severity}: {name}: {finding.line()}"
            sys.stderr.write(f"polemap: {_short(line)}\n")
    if refused:
        raise InputError(_short(f"{name}: {refused[0].line()}") + " (--force goes on)")


def _short(line: str) -> str:
    line = " ".join(line.split())
    return line if len(line) <= _LINE_MAX else line[: _LINE_MAX - 1] + "…"
