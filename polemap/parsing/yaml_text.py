"""YAML from files and options, without what makes it dangerous.

Aliases are allowed, since `yaml.safe_dump` writes them for values that stand twice, but count as
often as they stand: ten lines of them can mean a billion values.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from polemap.parsing.errors import ParsingError, short
from polemap.parsing.text import MEGABYTE, read_text

LARGEST_BYTES = MEGABYTE
DEEPEST = 32
MOST_VALUES = 100_000
LONGEST_NUMBER = 40

_CONSTRUCTORS_RAISE = (ValueError, TypeError, ArithmeticError, LookupError, AttributeError)


def _loader(base: Any) -> Any:
    """A loader that says on which line a date, a number or a key stands that is none."""

    class Loader(base):  # type: ignore[misc]
        def construct_object(self, node: Any, deep: bool = False) -> Any:
            try:
                return super().construct_object(node, deep)
            except _CONSTRUCTORS_RAISE as error:
                value = str(node.value)[:40] if isinstance(node, yaml.ScalarNode) else "the value"
                raise yaml.constructor.ConstructorError(
                    None, None, f"{value}: {short(error)}", node.start_mark
                ) from error

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen: set[str] = set()
            pairs = node.value if isinstance(node, yaml.MappingNode) else []
            for key, _ in pairs:
                # of two values the last would win in silence; merged keys may be overridden
                if isinstance(key, yaml.ScalarNode) and key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key {key.value[:40]} stands twice", key.start_mark
                    )
                if isinstance(key, yaml.ScalarNode) and not key.tag.endswith(":merge"):
                    seen.add(key.value)
            return super().construct_mapping(node, deep)

    return Loader


# the one in C is ten times as fast, where the package has it
_Loader = _loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def read_yaml(path: Path) -> Any:
    """The value that a YAML file holds.

    Raises:
        ParsingError: no YAML, or beyond a limit.
        OSError: it cannot be read.
    """
    return parse_yaml(read_text(path, LARGEST_BYTES))


def _value(text: str) -> Any:
    loader = _Loader(text)
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()


def parse_yaml(text: str) -> Any:
    """The value that YAML text holds: dicts, lists, texts, numbers, dates.

    Raises:
        ParsingError: no YAML, or beyond a limit: depth, number of values, digits of a number.
    """
    try:
        _check_events(yaml.parse(text, Loader=_Loader))
        value = _value(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark is not None else ""
        raise ParsingError(f"not YAML ({line}{short(error.problem or error)})") from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise ParsingError(f"not YAML ({short(error)})") from error
    except _CONSTRUCTORS_RAISE as error:
        raise ParsingError(f"a value cannot be read ({short(error)})") from error
    _check_values(value)
    return value


def yaml_node(text: str) -> yaml.Node | None:
    """The nodes, with their lines, of a text that `parse_yaml` has taken, by the same loader.

    The loader in Python refuses a tab that libyaml takes.
    """
    node: yaml.Node | None = yaml.compose(text, Loader=_Loader)
    return node


def _check_events(events: Iterator[Any]) -> None:
    """Depth and number of values, an alias counted as all that it stands for."""
    sizes: dict[str, int] = {}
    # of the open collections: anchor, and values so far
    open_now: list[tuple[str | None, int]] = [(None, 0)]
    for event in events:
        if isinstance(event, yaml.CollectionStartEvent):
            if len(open_now) > DEEPEST:
                raise ParsingError(f"{_line(event)}: nested deeper than {DEEPEST} levels")
            open_now.append((event.anchor, 1))
            continue
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, size = open_now.pop()
        elif isinstance(event, yaml.ScalarEvent):
            anchor, size = event.anchor, 1
            if len(event.value) > LONGEST_NUMBER and event.value.lstrip("+-").isdigit():
                raise ParsingError(
                    f"{_line(event)}: a number of {len(event.value)} digits, {LONGEST_NUMBER} are "
                    "the most"
                )
        elif isinstance(event, yaml.AliasEvent):
            anchor = None
            if event.anchor not in sizes:
                raise ParsingError(
                    f"{_line(event)}: the alias *{event.anchor} names nothing, or itself"
                )
            size = sizes[event.anchor]
        else:
            continue
        if anchor is not None:
            sizes[anchor] = size
        above, count = open_now[-1]
        open_now[-1] = (above, count + size)
        if count + size > MOST_VALUES:
            raise ParsingError(f"{_line(event)}: more than {MOST_VALUES} values")


def _line(event: Any) -> str:
    return f"line {event.start_mark.line + 1}"


def _check_values(value: Any) -> None:
    """Numbers of a sane length; what stands twice is looked at once."""
    seen: set[int] = set()
    stack = [value]
    while stack:
        part = stack.pop()
        if isinstance(part, int) and abs(part) >= 10**LONGEST_NUMBER:
            raise ParsingError(f"a number of more than {LONGEST_NUMBER} digits")
        if isinstance(part, dict | list | tuple | set):
            if id(part) in seen:
                continue
            seen.add(id(part))
            stack += [*part.keys(), *part.values()] if isinstance(part, dict) else list(part)
