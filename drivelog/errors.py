"""The one base of what a user can mend, and its kinds.

`stereo` and `vehicle` stand below this room and know nothing of it: their `StereoError` and
`VehicleError` are plain `ValueError`s, which the commands report in the same way.
"""


class PolemapError(Exception):
    """Base of every error that the user can mend. The message says what, where and how."""


class InputError(PolemapError):
    """A file that is missing, truncated or holds a value that cannot be used."""


class FrameError(PolemapError):
    """Two things in different earth frames were put together."""


class ConfigError(PolemapError):
    """A setting that is unknown or out of its range."""
