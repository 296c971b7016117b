"""How long each stage of the localizer takes, where somebody gives it a clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import nan


class StageTimes:
    """Collects the time of every call of a stage.

    Args:
        clock: a monotonic clock in seconds; None collects nothing.
    """

    def __init__(self, clock: Callable[[], float] | None) -> None:
        self._clock = clock
        self.seconds: dict[str, list[float]] = {}

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Time what runs inside, also if it raises."""
        if self._clock is None:
            yield
            return
        begin = self._clock()
        try:
            yield
        finally:
            self.seconds.setdefault(stage, []).append(self._clock() - begin)

    def last_s(self, stage: str) -> float:
        """The time that the last call of a stage took; NaN without a clock."""
        return self.seconds[stage][-1] if self._clock is not None else nan
