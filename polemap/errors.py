"""The base of every error that a user can mend; each room adds its kinds."""


class PolemapError(Exception):
    """Base of every error that the user can mend. The message says what, where and how."""
