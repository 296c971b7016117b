"""What goes wrong in this room."""

from polemap.errors import PolemapError


class VehicleError(PolemapError, ValueError):
    """A value that no vehicle, filter or estimator here can work with; the message names it."""
