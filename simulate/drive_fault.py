"""What every fault of a drive has: a span of time, and a way to change the drive."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from polemap.drivelog.drive import Drive

Floats = NDArray[np.float64]
Share = Annotated[float, Field(ge=0, le=1)]


class DriveFault(BaseModel, ABC):
    """A fault between `from_s` and `until_s` of the drive's stamps."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    from_s: float = float("-inf")
    until_s: float = float("inf")

    def during(self, stamps_s: Floats) -> NDArray[np.bool_]:
        """Which stamps the fault covers."""
        return np.asarray((stamps_s >= self.from_s) & (stamps_s < self.until_s))

    @abstractmethod
    def apply(self, drive: Drive, rng: np.random.Generator) -> Drive:
        """The drive with this fault in it."""
