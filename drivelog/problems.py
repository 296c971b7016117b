"""Mistakes in a mapping, a log or a drive.yaml: gathered, and told all at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from typing import Any, ParamSpec, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from polemap.drivelog.errors import InputError, Mistakes

CHOOSE = "CHOOSE"  # what a file that we wrote leaves to the user
_SHOWN_ROWS, _SHOWN_LETTERS = 2, 36
P = ParamSpec("P")
T = TypeVar("T")


class Gathered:
    """Errors of several steps, each of which goes on without the others."""

    def __init__(self) -> None:
        self.errors: list[InputError] = []

    def attempt(self, step: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """What a step gives; where it is refused, its error is kept, and None is given."""
        try:
            return step(*args, **kwargs)
        except InputError as error:
            self.errors.append(error)
            return None

    def at(self, place: str, step: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """`attempt` of a step whose error does not say its place."""
        try:
            return step(*args, **kwargs)
        except InputError as error:
            self.errors.append(InputError(f"{place}: {error}"))
            return None

    def error(self, place: object) -> InputError:
        """The only error that was kept, or a `Mistakes` with all."""
        if len(self.errors) == 1:
            return self.errors[0]
        lines: list[str] = []
        for error in self.errors:
            if isinstance(error, Mistakes):
                lines += [f"{error.place}: {mistake}" for mistake in error.mistakes]
            else:
                lines.append(str(error))
        return Mistakes(str(place), lines)


def refusal(place: object, mistakes: Sequence[str]) -> InputError:
    """The error for one mistake or several; `Mistakes` tells them all."""
    if len(mistakes) == 1:
        return InputError(f"{place}: {mistakes[0]}")
    return Mistakes(str(place), mistakes)


def first_rows(lines: Sequence[str]) -> str:
    """The first lines of a log, as they stand there, short enough for a message."""
    shown = [line.strip().replace("\t", "→") for line in lines if line.strip()][:_SHOWN_ROWS]
    cut = [s if len(s) <= _SHOWN_LETTERS else f"{s[: _SHOWN_LETTERS - 1]}…" for s in shown]
    return " ".join(f"«{line}»" for line in cut)


def did_you_mean(name: str, known: Sequence[str]) -> str:
    """`; did you mean X?` or nothing."""
    lower = {k.lower(): k for k in known}
    near = get_close_matches(name.lower(), list(lower), n=1)
    return f"; did you mean '{lower[near[0]]}'?" if near else ""


def validation_mistakes(
    error: ValidationError, model: type[BaseModel], prefix: str = ""
) -> list[str]:
    """What pydantic found, a line a mistake: key, what is wrong, what stands there, what to give.

    What to give is the description of the key and its example.
    """
    return [_mistake(problem, model, prefix) for problem in error.errors(include_url=False)]


def _mistake(problem: Any, model: type[BaseModel], prefix: str) -> str:
    # in brackets stand names of pydantic's own
    loc = [p for p in problem["loc"] if not str(p).startswith(("function-", "<"))]
    if problem["type"] == "extra_forbidden" and loc[-1:] != [problem["loc"][-1]]:
        loc.append(problem["loc"][-1])  # a key of the user's that looks like such a name
    place = (prefix + ".".join(str(part) for part in loc)).rstrip(".") or "top level"
    home, help_text = _described(model, loc)
    if problem["type"] == "extra_forbidden":
        known = [str(field.alias or name) for name, field in home.model_fields.items()]
        return f"{place}: unknown key; known: {', '.join(known)}{did_you_mean(str(loc[-1]), known)}"
    if problem["type"] == "missing":
        return f"{place}: is missing{help_text and f'; add {help_text}'}"
    found = problem["input"]
    if found == CHOOSE:
        return f"{place}: still says {CHOOSE}; give {help_text or 'a value'}"
    message = str(problem["msg"]).removeprefix("Value error, ")
    shown = "" if isinstance(found, dict) else f" (found {str(found)[:60]})"
    return f"{place}: {message}{shown}{help_text and f'; it is {help_text}'}"


def _described(model: type[BaseModel], loc: Sequence[Any]) -> tuple[type[BaseModel], str]:
    """The model that a key belongs to, and what the key is, with an example."""
    homes, text = [model], ""
    for part in loc:
        for home in homes:
            field = next(
                (f for name, f in home.model_fields.items() if str(part) in (name, f.alias)), None
            )
            if field is not None:
                break
        else:
            return homes[0], ""
        example = f", such as {field.examples[0]}" if field.examples else ""
        text = f"{(field.description or '').rstrip('.')}{example}"
        if part is loc[-1]:
            return home, text
        homes = inner_models(field.annotation) or [home]
    return homes[0], text


def inner_models(annotation: Any) -> list[type[BaseModel]]:
    """The models in an annotation such as `CameraPart | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in inner_models(inner)]
