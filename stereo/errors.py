"""What goes wrong in this room."""

from polemap.errors import PolemapError


class StereoError(PolemapError, ValueError):
    """An image pair, rig or setting that no matcher can work with; the message names it."""
