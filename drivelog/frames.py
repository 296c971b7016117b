"""Frames of the earth: a pinned UTM zone or a named local plane."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EarthFrame:
    """The plane that coordinates belong to: `epsg` of a UTM zone, or the `name` of a local one."""

    kind: str
    epsg: int | None = None
    name: str | None = None

    def __str__(self) -> str:
        return f"EPSG:{self.epsg}" if self.kind == "utm" else f"local frame '{self.name}'"
