"""A city in every format that is read by tiles."""

from __future__ import annotations

from pathlib import Path

import pytest

from polemap.map.pole_map import PoleMap
from tests.city_maps import write_city
from tests.polemap.map.city.cities import make_city


@pytest.fixture(scope="module")
def city() -> PoleMap:
    return make_city()


@pytest.fixture(scope="module")
def files(city: PoleMap, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The city in every format that is read by tiles, however small it is."""
    folder = tmp_path_factory.mktemp("city")
    return write_city(city, folder)
