"""The base of every error that a user can mend; each room adds its kinds."""

LONGEST_MESSAGE = 300
# what the terminal puts in front of a message
_PREFIX = "polemap: "


class PolemapError(Exception):
    """Base of every error that the user can mend. The message says what, where and how.

    It is one line of at most `LONGEST_MESSAGE` letters, that of the terminal's prefix included.
    """

    def __str__(self) -> str:
        return shortened(super().__str__())


def shortened(message: str) -> str:
    """A message as one line that is not too long; place and remedy stand at its ends."""
    room = LONGEST_MESSAGE - len(_PREFIX)
    message = " ".join(message.split())
    message = "".join(letter if letter.isprintable() else "?" for letter in message)
    if len(message) <= room:
        return message
    head = (room - 3) // 2
    return f"{message[:head]}...{message[-(room - 3 - head) :]}"
