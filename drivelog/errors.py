"""What goes wrong with files, earth frames and settings."""

from polemap.errors import PolemapError

__all__ = ["ConfigError", "FrameError", "InputError", "OutputError", "PolemapError", "WorkerError"]


class InputError(PolemapError):
    """A file that is missing, truncated or holds a value that cannot be used."""


class OutputError(PolemapError):
    """A result that cannot be written where it was asked for, or would cost somebody's files."""


class FrameError(PolemapError):
    """Two things in different earth frames were put together."""


class ConfigError(PolemapError):
    """A setting that is unknown or out of its range."""


class WorkerError(PolemapError):
    """Worker processes that end before their work does."""
