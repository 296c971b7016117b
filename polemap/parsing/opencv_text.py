"""What OpenCV's FileStorage writes, YAML or XML, as plain dicts and arrays.

Read here and not by OpenCV, whose parser has no limits and says what is wrong on stderr only.
"""

from __future__ import annotations

import re
from math import prod
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from polemap.parsing.errors import ParsingError, short
from polemap.parsing.yaml_text import parse_yaml

# of two dimensions, and since OpenCV 5 of any number
_MATRIX_KEYS, _ARRAY_KEYS = {"rows", "cols", "data"}, {"sizes", "data"}


def parse_opencv(text: str) -> dict[str, Any]:
    """The named values of a FileStorage file; matrices as arrays `(rows, cols)`.

    Plain YAML and JSON with the same names are read, too.

    Raises:
        ParsingError: neither YAML nor XML, no names in it, or a matrix that is not one.
    """
    if text.lstrip().startswith("<?xml") or text.lstrip().startswith("<opencv_storage"):
        tree = _xml(text)
    else:
        # the header is older than YAML's own, and the tag is unknown to every other parser
        plain = re.sub(r"\A\s*%YAML:1\.0[^\n]*\n", "", text)
        tree = parse_yaml(re.sub("!!opencv-(nd-)?matrix", "", plain))
    if not isinstance(tree, dict):
        raise ParsingError("holds no names with values")
    return {str(name): _value(str(name), value) for name, value in tree.items()}


def _value(name: str, value: Any) -> Any:
    if isinstance(value, dict) and (value.keys() >= _MATRIX_KEYS or value.keys() >= _ARRAY_KEYS):
        return _matrix(name, value)
    return value


def _matrix(name: str, value: dict[str, Any]) -> NDArray[np.float64]:
    try:
        sizes = value.get("sizes", (value.get("rows"), value.get("cols")))
        shape = tuple(int(size) for size in _words(sizes))
        words = _words(value["data"])
        numbers = np.array([_number(word) for word in words], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ParsingError(f"matrix {name} cannot be read ({short(error)})") from error
    if not shape or min(shape) < 0 or numbers.size != prod(shape):
        said = "x".join(str(size) for size in shape)
        raise ParsingError(f"matrix {name} is {said}, but holds {numbers.size}")
    return numbers.reshape(shape)


def _words(value: Any) -> Any:
    return value.split() if isinstance(value, str) else value


def _number(word: Any) -> float:
    """A number as OpenCV writes it; its .Nan and .Inf are spelled as no YAML parser expects."""
    return float(str(word).lower().replace(".nan", "nan").replace(".inf", "inf"))


def _xml(text: str) -> Any:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ParsingError("XML with declarations of its own is not read")
    try:
        # neither entities nor declarations are left, and the size of the file is limited
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ParsingError(f"not XML ({short(error)})") from error
    return {node.tag: _node(node) for node in root}


def _node(node: ElementTree.Element) -> Any:
    if len(node):
        return {child.tag: (child.text or "").strip() for child in node}
    return (node.text or "").strip().strip('"')
