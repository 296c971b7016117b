"""What a mapping file says of one column: where it stands, its unit, its signs, its clock."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Column = int | str
"""A column by its number, from 1, or by its name in the header."""


class Part(BaseModel):
    """A part of a mapping; unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Where(Part):
    """Rows by what another column holds."""

    column: Column
    values: tuple[str | int | float, ...] = Field((), alias="in")
    least: float | None = Field(None, alias="min")
    most: float | None = Field(None, alias="max")

    @model_validator(mode="after")
    def _says_something(self) -> Where:
        if bool(self.values) == (self.least is not None or self.most is not None):
            raise ValueError("needs `in: [values]`, or `min`, `max` or both")
        return self


class Stamps(Part):
    """When a row was measured: a number in a unit, a text, or GPS week and seconds."""

    column: Column | None = None
    columns: tuple[Column, ...] = ()
    unit: str | None = None
    format: str | None = None
    zone: str | None = None
    date: str | None = None
    week: Column | None = None
    epoch: Literal["unix", "gps"] = "unix"
    leap_seconds: int | None = None
    offset: float = Field(0.0, allow_inf_nan=False)

    @model_validator(mode="after")
    def _one_way(self) -> Stamps:
        if (self.column is None) == (not self.columns):
            raise ValueError("needs `column`, or `columns` whose texts are joined by a blank")
        if self.uses_gps and self.leap_seconds is None:
            raise ValueError(
                "GPS time needs leap_seconds, by which it is ahead of UTC (18 since 2017), or 0 to "
                "keep GPS time"
            )
        if self.leap_seconds is not None and not self.uses_gps:
            raise ValueError("leap_seconds needs `week` or `epoch: gps`")
        if self.uses_gps and (self.format or self.columns):
            raise ValueError("GPS time is a number: `column` and `unit`, without `format`")
        return self

    @property
    def uses_gps(self) -> bool:
        """Whether the numbers count from the GPS epoch or from the start of its week."""
        return self.week is not None or self.epoch == "gps"


class Value(Part):
    """One of our columns, from one or several of the logger's.

    Our value is `sign * (cell * scale, taken from unit) + offset`, the mean over `columns`.
    """

    column: Column | None = None
    columns: tuple[Column, ...] = ()
    value: float | None = Field(None, allow_inf_nan=False)
    unit: str | None = None
    scale: float | None = Field(None, allow_inf_nan=False)
    offset: float = Field(0.0, allow_inf_nan=False)
    sign: Literal[1, -1] = 1
    turn: Literal["clockwise", "counter_clockwise"] | None = None
    zero: Literal["true_north", "grid_north", "true_east", "grid_east"] | None = Field(
        None, alias="from"
    )
    negative_where: Where | None = None
    file: str | None = None
    stamp_s: Stamps | None = None
    where: Where | None = None
    fill: Literal["previous", "linear"] | None = None
    fill_max_s: float = Field(0.5, gt=0.0, allow_inf_nan=False)

    @model_validator(mode="after")
    def _one_source(self) -> Value:
        given = [self.column is not None, bool(self.columns), self.value is not None]
        if sum(given) != 1:
            raise ValueError("needs one of `column`, `columns` (their mean) and `value`")
        if self.file is not None and self.stamp_s is None:
            raise ValueError("has a file of its own and needs `stamp_s` there, too")
        if self.scale == 0.0:
            raise ValueError("scale is 0, which makes every value 0; give `value: 0.0` instead")
        return self

    @property
    def sources(self) -> tuple[Column, ...]:
        """The logger's columns."""
        return self.columns or (() if self.column is None else (self.column,))


class Lever(Part):
    """Where on the car a reference is measured, in the vehicle frame."""

    x_m: float = Field(allow_inf_nan=False)
    y_m: float = Field(allow_inf_nan=False)
