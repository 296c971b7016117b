"""The section `format` of a mapping: how the text of a log is laid out."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

_MARKS = {"comma": ",", "semicolon": ";", "tab": "\t", "\\t": "\t", "bar": "|", "blanks": " "}


class FormatPart(BaseModel):
    """Layout of a text table; whatever is not stated is taken from the text, or asked for."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    separator: (
        Literal[",", ";", "\t", "|", " ", "comma", "semicolon", "tab", "\\t", "bar", "blanks"]
        | None
    ) = Field(None, description="Mark between columns; `blanks` is any run of blanks.")
    decimal: Literal[".", ","] | None = Field(None, description="Decimal mark.")
    thousands: Literal[".", ",", "'", " "] | None = Field(None, description="Mark of thousands.")
    encoding: str | None = Field(None, description="Such as utf-8, utf-16 or latin-1.")
    header_line: int | Literal["none"] | None = Field(
        None, description="Number of the line with the names, from 1; `none` without one."
    )
    units_line: int | None = Field(None, ge=1, description="Number of the line with the units.")
    skip_lines: tuple[int, ...] = Field((), description="Numbers of lines that are no data.")
    comment: str | None = Field(None, min_length=1, description="What comment lines begin with.")
    missing: tuple[str, ...] = Field((), description="Further texts that stand for no value.")
    bad_lines: Literal["refuse", "drop"] = Field(
        "refuse", description="What becomes of lines with another number of cells."
    )

    @field_validator("header_line")
    @classmethod
    def _from_one(cls, value: int | str | None) -> int | str | None:
        if isinstance(value, int) and value < 1:
            raise ValueError("lines count from 1")
        return value

    @model_validator(mode="after")
    def _marks_differ(self) -> FormatPart:
        if self.decimal is not None and self.decimal == self.thousands:
            raise ValueError("decimal and thousands are the same mark")
        return self

    @property
    def no_header(self) -> bool:
        """Whether the mapping says that no line names the columns."""
        return self.header_line == "none"

    @property
    def header_number(self) -> int | None:
        """The line that names the columns, where the mapping says which."""
        return self.header_line if isinstance(self.header_line, int) else None

    def separator_mark(self) -> str | None:
        """The mark itself."""
        return None if self.separator is None else _MARKS.get(self.separator, self.separator)
