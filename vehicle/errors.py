"""What goes wrong in this room."""


class VehicleError(ValueError):
    """A value that no vehicle, filter or estimator here can work with; the message names it."""
