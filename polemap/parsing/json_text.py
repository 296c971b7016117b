"""JSON from files and metadata: bounded in size, depth and digits; and values for JSON to write."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from polemap.parsing.errors import ParsingError, short
from polemap.parsing.text import MEGABYTE, read_text

LARGEST_BYTES = 1000 * MEGABYTE
DEEPEST = 64
LONGEST_NUMBER = 40


def read_json(path: Path, largest_bytes: int = LARGEST_BYTES) -> Any:
    """The value that a JSON file holds.

    Raises:
        ParsingError: no JSON, or beyond a limit.
        OSError: it cannot be read.
    """
    return parse_json(read_text(path, largest_bytes))


def parse_json(text: str) -> Any:
    """The value that JSON text holds.

    Raises:
        ParsingError: no JSON, nested too deep, a number too long, or half a character.
    """
    try:
        value = json.loads(text, parse_int=_whole, parse_float=_number)
    except RecursionError as error:
        raise ParsingError(f"nested deeper than {DEEPEST} levels") from error
    except ValueError as error:
        raise ParsingError(f"not JSON ({short(error)})") from error
    _check_depth(value)
    if "\\ud" in text or "\\uD" in text:
        try:
            json.dumps(value, ensure_ascii=False).encode("utf-8")
        except UnicodeEncodeError as error:
            raise ParsingError("a text holds half a character (a lone surrogate)") from error
    return value


def plain_values(value: Any) -> Any:
    """Plain Python values for JSON, which has no NaN and no infinity: they become None."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    if isinstance(value, np.generic):
        return plain_values(value.item())
    if isinstance(value, float) and not isfinite(value):
        return None
    return value


def _whole(digits: str) -> int:
    if len(digits) > LONGEST_NUMBER:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def _number(digits: str) -> float:
    if len(digits) > 1000:
        raise ValueError(f"a number of {len(digits)} digits")
    return float(digits)


def _check_depth(value: Any) -> None:
    level = [value] if isinstance(value, dict | list) else []
    for _ in range(DEEPEST):
        below: list[Any] = []
        for part in level:
            inner = part.values() if isinstance(part, dict) else part
            below += [one for one in inner if isinstance(one, dict | list)]
        if not below:
            return
        level = below
    raise ParsingError(f"nested deeper than {DEEPEST} levels")
