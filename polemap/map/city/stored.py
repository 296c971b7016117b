"""What a city map's file says of itself, as JSON in its metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.statistics import MapStatistics
from polemap.parsing.errors import ParsingError
from polemap.parsing.json_text import parse_json

# from here on a map is written in tiles and opened without reading its poles: 50,000 poles are read
# in a tenth of a second, a thousand square kilometres of streets hold more
CITY_POLES = 50_000
METADATA_KEY = "polemap_city"
_VERSION = 1


@dataclass(frozen=True, slots=True)
class StoredCity:
    """The frame, the statistics, and what else the format needs."""

    frame: EarthFrame
    statistics: MapStatistics
    details: Mapping[str, Any]

    def to_text(self) -> str:
        """As JSON on one line."""
        return json.dumps(
            {
                "format_version": _VERSION,
                "frame": self.frame.to_dict(),
                "statistics": self.statistics.to_dict(),
                **self.details,
            },
            allow_nan=False,
            separators=(",", ":"),
        )

    @classmethod
    def from_text(cls, text: str) -> StoredCity | None:
        """The inverse; None of a later version, or of none.

        Raises:
            InputError: not what `to_text` writes.
        """
        try:
            values = parse_json(text)
            if values["format_version"] != _VERSION:
                return None
            return cls(
                EarthFrame.from_dict(values["frame"]),
                MapStatistics.from_dict(values["statistics"]),
                {
                    name: value
                    for name, value in values.items()
                    if name not in ("format_version", "frame", "statistics")
                },
            )
        except (ParsingError, KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"its metadata '{METADATA_KEY}' cannot be read ({error})") from error
