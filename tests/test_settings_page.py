"""The reference page of the settings is what the code says."""

from __future__ import annotations

import pytest
from pydantic import BaseModel

from docs.make_settings import PAGE, leaves, meaning_of, page
from polemap.electric.config import EstimatorConfig
from polemap.settings import Settings


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make docs`"


def test_every_setting_stands_on_the_page_once_in_its_group() -> None:
    text = page()
    for key, _, name in leaves(Settings()):
        assert f"| `{name}` |" in text, key


@pytest.mark.parametrize("room", [*Settings.model_fields, "electric"])
def test_every_setting_is_described(room: str) -> None:
    group = EstimatorConfig() if room == "electric" else getattr(Settings(), room)
    silent = [key for key, own, name in leaves(group) if not meaning_of(name, own)]
    assert not silent


class Grouped(BaseModel):
    """A group.

    Attributes:
        one, two: what both
            mean.
    """

    one: int = 1
    two: int = 2


def test_a_docstring_describes_where_a_field_does_not() -> None:
    assert meaning_of("two", Grouped()) == "what both mean."
