"""What goes wrong with files, earth frames and settings."""

from polemap.errors import PolemapError

__all__ = ["ConfigError", "FrameError", "InputError", "PolemapError"]


class InputError(PolemapError):
    """A file that is missing, truncated or holds a value that cannot be used."""


class FrameError(PolemapError):
    """Two things in different earth frames were put together."""


class ConfigError(PolemapError):
    """A setting that is unknown or out of its range."""
