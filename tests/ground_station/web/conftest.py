"""A day with its map, closed at the end."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ground_station.web.map_site import MapSite


@pytest.fixture
def site(tmp_path: Path) -> Iterator[MapSite]:
    made = MapSite(tmp_path)
    yield made
    made.close()
