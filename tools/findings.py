"""Findings of the plausibility checks on the screen: one line each, and errors refuse."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding, Severity

_LINE_MAX = 240


def _on_stderr(severity: Severity, line: str) -> None:
    sys.stderr.write(f"polemap: {_short(f'{severity}: {line}')}\n")


def require_plausible(
    name: str,
    found: Sequence[Finding],
    *,
    force: bool,
    say: Callable[[Severity, str], None] = _on_stderr,
    way_on: str = "--force",
) -> None:
    """Say findings, one line each; errors refuse, in one line alone, unless forced.

    Args:
        name: of the drive or log.
        found: the findings, errors first.
        force: go on with errors.
        say: takes severity and line.
        way_on: how the caller goes on with errors.

    Raises:
        InputError: a finding of severity `error`, and not `force`.
    """
    errors = [finding for finding in found if finding.severity == "error"]
    if errors and not force:
        more = f", {len(found) - 1} more in polemap info" if len(found) > 1 else ""
        raise InputError(_short(f"{name}: {errors[0].line()}") + f" ({way_on} goes on{more})")
    for finding in found:
        say(finding.severity, _short(f"{name}: {finding.line()}"))


def _short(line: str) -> str:
    """At most `_LINE_MAX` letters, from the middle: place and remedy stand at the ends."""
    line = " ".join(line.split())
    if len(line) <= _LINE_MAX:
        return line
    head = _LINE_MAX // 2
    return f"{line[:head]}…{line[head + 1 - _LINE_MAX :]}"
