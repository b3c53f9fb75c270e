"""Background of the map: the user's base map in either schema, or the outline of the world."""

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from ground_station.adapters.web.npm_assets import (
    OUTLINE,
    PACKAGES,
    NpmPackage,
    packages_with_missing_files,
)
from tests.ground_station.web.browser import (
    OPENMAPTILES,
    PROTOMAPS,
    browsing,
    needs_chromium,
    running,
    town_tiles,
    wait_until,
)
from tests.ground_station.web.map_site import HARBOUR, MapSite

pytestmark = pytest.mark.timeout(180)

WATER = (185, 211, 230)
"""The page's colour of water in the light: the whole tile of the test is water."""

ON_MAP_PX = 480, 300
"""On the map, beside its panels and symbols."""

WORLD_PX = 512 * 2**1.5
LEAST_NAME_PX = 40
"""Minimum width of twelve letters."""


def colour_at(page, x: int, y: int) -> tuple[int, ...]:
    """A pixel of what is seen."""
    png = page.screenshot(clip={"x": x, "y": y, "width": 1, "height": 1})
    red, green, blue = (255 * imread(io.BytesIO(png))[0, 0, :3]).round().astype(int).tolist()
    return red, green, blue


def wide_of_name(page, site: MapSite) -> int:
    """Columns of the screen in which `TOWN` is written, once it is; Web Mercator by hand, with
    the equator in the middle, as after zooming out to the whole world.
    """
    east = (0.25 - (0.5 + HARBOUR.day.depot.lon_deg / 360.0)) * WORLD_PX
    width = 0
    for _ in range(100):  # names fade in
        site.step()  # without data the page turns grey
        box = page.locator("#place").bounding_box()  # the timeline below it grows with the fleet
        x, y = box["x"] + box["width"] / 2 + east, box["y"] + box["height"] / 2
        clip = {"x": x - 60, "y": y - 6, "width": 120, "height": 12}
        seen = 255 * imread(io.BytesIO(page.screenshot(clip=clip)))[..., :3]
        columns = (seen.sum(axis=2) < 300).any(axis=0).nonzero()[0]
        width = int(np.ptp(columns)) if columns.size else 0
        if width > LEAST_NAME_PX:
            break
        page.wait_for_timeout(100)
    return width


@pytest.fixture(scope="module")
def chromium() -> Iterator:
    """One browser for all windows of this module."""
    with running(needs_chromium()) as browser:
        yield browser


def needs(packages: tuple[NpmPackage, ...]) -> None:
    if missing := packages_with_missing_files(packages):
        pytest.skip(f"`make map-assets` was not run ({', '.join(missing)}): nothing was drawn")


@pytest.mark.parametrize("schema", [PROTOMAPS, OPENMAPTILES], ids=["protomaps", "openmaptiles"])
def test_a_base_map_is_drawn_from_the_users_file_with_its_attribution(
    site: MapSite, chromium, tmp_path: Path, schema: tuple[str, str]
):
    needs(PACKAGES)
    town = tmp_path / "town.pmtiles"
    town_tiles(town, schema)
    site.start_map(basemap=town)
    site.step()
    with browsing(chromium, viewport={"width": 1440, "height": 900}) as page:
        page.goto(site.address)
        page.get_by_text("made by hand").wait_for()
        page.locator("#basemap canvas").wait_for()
        for _ in range(100):
            site.step()  # without data the page turns grey
            if colour_at(page, *ON_MAP_PX) == WATER:
                break
            page.wait_for_timeout(100)
        assert colour_at(page, *ON_MAP_PX) == WATER
        for key in ["-"] * 40 + ["+"] * 3:
            page.keyboard.press(key)  # to zoom 1.5
        assert wide_of_name(page, site) > LEAST_NAME_PX, "without a server of glyphs"


LAND = ((52.0, 20.0), (7.5, 80.7), (66.5, -172.0))
SEA = ((45.0, -30.0), (5.0, 80.7), (70.0, 0.0))
"""Poland, Sri Lanka, Chukotka beyond the date line; the Atlantic north of the Azores, south of Sri
Lanka, and the Norwegian Sea, through which coasts that are not cut at the date line run.
"""


def test_far_out_the_outline_of_the_world_is_drawn_and_near_the_day_it_is_not(
    site: MapSite, chromium
):
    needs(OUTLINE)
    site.start_map(outline=True)
    site.step()
    with browsing(chromium, color_scheme="light") as page:
        page.goto(site.address)
        drawing = page.locator("#outline g")
        drawing.wait_for(state="attached")
        wait_until(page, "document.querySelector('#outline g').getAttribute('display') == 'none'")
        assert page.locator("#attribution").inner_text() == "No base map given"
        for key in ["-"] * 40 + ["+"] * 3:
            page.keyboard.press(key)
        page.get_by_text("Outline: Natural Earth").wait_for()
        wait_until(page, "document.querySelector('#outline g').getAttribute('display') == 'inline'")
        assert all(in_land(page, *place) for place in LAND)
        assert not any(in_land(page, *place) for place in SEA)


def in_land(page, lat_deg: float, lon_deg: float) -> bool:
    """Whether this place lies in the path that is filled as land (the browser's own test)."""
    ask = """async ([lat, lon]) => {
      const { unit } = await import('/page/view.js');
      const land = document.querySelector('#outline .land');
      const [x, y] = unit([lat, lon]);
      return land.isPointInFill(new DOMPoint(x * 512 * 64, y * 512 * 64));
    }"""
    return page.evaluate(ask, [lat_deg, lon_deg])
