"""What goes wrong with files, earth frames and settings."""

from __future__ import annotations

from collections.abc import Sequence

from polemap.errors import PolemapError

__all__ = [
    "ConfigError",
    "FrameError",
    "InputError",
    "Mistakes",
    "OutputError",
    "PolemapError",
    "WorkerError",
]


class InputError(PolemapError):
    """A file that is missing, truncated or holds a value that cannot be used."""


class Mistakes(InputError):
    """Several mistakes in one input, all told at once.

    Attributes:
        place: file that holds them.
        mistakes: each with key or line, and its remedy.
    """

    def __init__(self, place: str, mistakes: Sequence[str]) -> None:
        super().__init__(f"{place}: {len(mistakes)} mistakes: {'; '.join(mistakes)}")
        self.place, self.mistakes = place, tuple(mistakes)

    @property
    def lines(self) -> tuple[str, ...]:
        """What a command prints: the place with the number of mistakes, then a line a mistake."""
        return (f"{self.place}: {len(self.mistakes)} mistakes", *self.mistakes)

    def __reduce__(self) -> tuple[type[Mistakes], tuple[str, tuple[str, ...]]]:
        return type(self), (self.place, self.mistakes)


class OutputError(PolemapError):
    """A result that cannot be written where it was asked for, or would cost somebody's files."""


class FrameError(PolemapError):
    """Two things in different earth frames were put together."""


class ConfigError(PolemapError):
    """A setting that is unknown or out of its range."""


class WorkerError(PolemapError):
    """Worker processes that end before their work does."""
