"""What goes wrong when a file is read, and the net below all readers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from polemap.errors import PolemapError

# what libraries raise on damaged input; each reader checks what it knows, this is the net below
_RAISED = (
    ArithmeticError, AttributeError, EOFError, LookupError, RecursionError, RuntimeError,
    SyntaxError, TypeError, ValueError,
)  # fmt: skip
_SHOWN = 120


class ParsingError(PolemapError):
    """Bytes or text that are no such document, or go beyond a limit; the message says where."""


def short(error: BaseException | str) -> str:
    """The first words of what a library said, on one line."""
    text = " ".join(str(error).split())
    if not text and isinstance(error, BaseException):
        text = type(error).__name__
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


@contextmanager
def named(path: Path | str, kind: type[PolemapError], what: str = "file") -> Iterator[None]:
    """Whatever reading `path` raises becomes one line of `kind` that begins with the path.

    Errors for the user pass as they are, but for a `ParsingError`, which knows no path.

    Raises:
        PolemapError: of `kind`, or as the block raised it.
    """
    try:
        yield
    except ParsingError as error:
        raise kind(f"{path}: {error}") from error
    except PolemapError:
        raise
    except OSError as error:
        reason = error.strerror or short(error)
        raise kind(f"{path}: cannot be read ({reason})") from error
    except MemoryError as error:
        raise kind(f"{path}: this {what} asks for more memory than there is; restore it") from error
    except _RAISED as error:
        raise kind(f"{path}: damaged, or no such {what} ({short(error)}); restore it") from error
