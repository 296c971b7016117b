"""What goes wrong in this room."""


class StereoError(ValueError):
    """An image pair, rig or setting that no matcher can work with; the message names it."""
