"""The settings of the localizer: described, bounded, few."""

from __future__ import annotations

from collections.abc import Iterator

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from benchmarks.departures.cases import printed_keys
from polemap.localize.config import LocalizeConfig


def _settings(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _settings(field.annotation, f"{prefix}{name}.")
        else:
            yield prefix + name, field


def test_every_setting_says_what_it_is_and_has_its_range() -> None:
    settings = dict(_settings(LocalizeConfig))
    # what only switches back to the printed method is no figure that a user has to choose
    switches = {key.removeprefix("localize.") for key in printed_keys()}
    assert len(settings.keys() - switches) <= 35
    for name, field in settings.items():
        assert field.description, name
        if field.annotation in (int, float):
            kinds = (annotated_types.Ge, annotated_types.Gt, annotated_types.Le, annotated_types.Lt)
            bounds = [limit for limit in field.metadata if isinstance(limit, kinds)]
            assert len(bounds) == 2, name


def test_the_settings_that_scripts_turn_keep_their_names() -> None:
    names = dict(_settings(LocalizeConfig))
    assert {"particles", "p_detection", "beta_p", "output.rate_hz"} <= set(names)
    assert sum(name.startswith("alpha") for name in names) == 6
