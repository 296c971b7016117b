"""What was found when the inputs were held against each other: one line a finding."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

Severity = Literal["error", "warning", "note"]
_ORDER = {"error": 0, "warning": 1, "note": 2}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that cannot be right, or that a reader of a result must know.

    Attributes:
        kind: what it is, in snake case: `speed_unit`, `clock_offset` and so on.
        severity: `error` makes the result worthless, `warning` makes it doubtful, `note` was
            dealt with.
        stream: the file or stream at fault, as far as the agreement of the others tells.
        value: what was seen.
        expected: what was expected instead, and what says so.
        remedy: what the user can do.
    """

    kind: str
    severity: Severity
    stream: str
    value: str
    expected: str
    remedy: str

    def line(self) -> str:
        """The finding in one line."""
        return f"{self.stream}: {self.value}; expected {self.expected}; {self.remedy}"

    def to_dict(self) -> dict[str, str]:
        """As JSON has it."""
        return asdict(self)


def worst_first(findings: list[Finding]) -> list[Finding]:
    """Errors, then warnings, then notes; as they came within each."""
    return sorted(findings, key=lambda finding: _ORDER[finding.severity])
