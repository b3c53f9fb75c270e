"""Hours of geo-zones applied to the desk's launches, on a day with its own hours."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec
import pytest

from companion.core.base.zone_times import parse_utc_s
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.order_store import Store
from ground_station.core.dispatch.zone_holds import ZoneHoldRules
from ground_station.core.schema.day_data import DayData
from tests.ground_station.desk.test_forecast_watch import DAYS, FAR, NEAR, Depot
from tests.ground_station.weather.open_meteo import START_S

HERE = ("2026-07-01T12:00:00Z", "2026-07-01T13:00:00Z")
"""The day's hours; the desk's clock starts at noon."""


def zone_about(
    data: DayData, order: str, low_m: float | None = None, **more: Any
) -> dict[str, Any]:
    """Return an ED-269 zone: a circle around an order's customer."""
    the = next(one for one in data.orders if one.id == order)
    volume: dict[str, Any] = {
        "uomDimensions": "M",
        "lowerLimit": low_m,
        "lowerVerticalReference": "AMSL",
        "horizontalProjection": {
            "type": "Circle", "center": [the.lon_deg, the.lat_deg], "radius": 60.0,
        },
    }  # fmt: skip
    table = {
        "identifier": "XXX0009", "country": "XXX", "name": "Fair", "type": "COMMON",
        "restriction": "PROHIBITED", "applicability": [], "geometry": [volume],
    }  # fmt: skip
    return {"features": [table | more]}


def hours(start: str, end: str) -> list[dict[str, str]]:
    return [{"startDateTime": f"2026-07-01T{start}Z", "endDateTime": f"2026-07-01T{end}Z"}]


def day_of(zones: Callable[[DayData], dict[str, Any]], **mission: Any) -> DayData:
    data = read_day(DAYS / "harbour.toml")
    terms = {"from_utc": HERE[0], "until_utc": HERE[1]} | mission
    day = msgspec.structs.replace(
        data.day, mission=msgspec.structs.replace(data.day.mission, **terms)
    )
    return replace(data, day=day, no_fly=zones(data))


def waiting(store: Store, data: DayData, order: str, minutes: float = 0.0) -> Depot:
    """Build the desk this many minutes after noon, with d1 ready with this order."""
    store.add_orders_unless_conflict(data.orders)
    site = Depot(store, data)
    site.clock.t_s += 60.0 * minutes
    site.aboard(order)
    site.phase = "ready"
    return site


def late(data: DayData) -> dict[str, Any]:
    """Return a zone in force from 13:10 to 14:00, after the day's hours."""
    return zone_about(data, FAR, applicability=hours("13:10:00", "14:00:00"))


def test_a_flight_that_would_still_be_out_when_a_zone_begins_is_held_with_its_name(store):
    site = waiting(store, day_of(late), FAR, minutes=68.0)
    site.run(30.0)
    assert site.wire.launches() == []
    why = site.holds()["d1"]
    assert why.startswith("zone XXX0009 Fair is or will be in force during its flight")
    assert "until 2026-07-01 14:0" in why
    assert f"d1: launch hold: {why}" in site.words()
    site.clock.t_s = 1000.0 + 7200.0 + 60.0
    site.run(20.0)
    assert site.holds() == {}
    assert f"d1: launch hold ended ({why})" in site.words()
    assert site.wire.launches() == [f"{FAR}.1:launch1"]


@pytest.mark.parametrize(
    ("order", "minutes"),
    [(FAR, 5.0), (NEAR, 68.0)],
    ids=["home long before it begins", "its way is elsewhere"],
)
def test_the_canary_whose_way_or_time_is_another_is_launched(store, order, minutes):
    site = waiting(store, day_of(late), order, minutes)
    site.run(30.0)
    assert site.holds() == {}
    assert site.wire.launches()[:1] == [f"{order}.1:launch1"]


def held(data: DayData, highest_m: float = 40.0, clock: str = "13:09:00") -> bool:
    the = next(one for one in data.orders if one.id == FAR)
    depot = data.day.depot
    north = (the.lat_deg - depot.lat_deg) * 111_320.0
    east = (the.lon_deg - depot.lon_deg) * 63_100.0
    way = ((0.0, 0.0), (north, east), (0.0, 0.0))
    now_s = parse_utc_s("", f"2026-07-01T{clock}Z")
    return ZoneHoldRules(data).find_zone_hold(way, highest_m, 600.0, now_s) is not None


def test_floors_count_as_they_do_for_a_flight():
    """Vertical margin: 8 m, and 24 m of avoidance above the flight (docs/how-to/geo-zones.md)."""

    def above(floor_m: float) -> Callable[[DayData], dict[str, Any]]:
        late_hours = hours("13:10:00", "14:00:00")
        return lambda data: zone_about(data, FAR, low_m=12.0 + floor_m, applicability=late_hours)

    assert held(day_of(above(40.0 + 32.0 - 1.0)))
    assert not held(day_of(above(40.0 + 32.0 + 1.0)))
    assert held(day_of(above(40.0 + 32.0 + 1.0)), highest_m=50.0)


@pytest.mark.parametrize(
    ("more", "mission"),
    [
        ({"restriction": "NO_RESTRICTION"}, {}),
        ({"restriction": "REQ_AUTHORISATION"}, {"authorised_zones": ["XXX0009"]}),
        ({}, {"from_utc": None, "until_utc": None}),  # the vehicle plans around it
        ({"applicability": []}, {}),
        ({"applicability": hours("12:30:00", "14:00:00")}, {}),
    ],
    ids=["free", "authorised", "no hours stated", "always in force", "in the day's hours"],
)
def test_zones_that_every_flight_keeps_out_of_or_may_enter_hold_nobody(more, mission):
    zones = lambda data: zone_about(  # noqa: E731
        data, FAR, **({"applicability": hours("13:10:00", "14:00:00")} | more)
    )
    assert not held(day_of(zones, **mission))


def test_the_end_is_looked_for_through_the_week_and_a_zone_without_an_end_says_so():
    weekly = [{"schedule": [{"day": ["WED"], "startTime": "13:10:00Z", "endTime": "15:00:00Z"}]}]
    data = day_of(lambda d: zone_about(d, FAR, applicability=weekly))  # 1 July 2026: a Wednesday
    assert held(data)
    assert not held(data, clock="15:00:01")
    endless = [{"startDateTime": "2026-07-01T13:10:00Z"}]
    data = day_of(lambda d: zone_about(d, FAR, applicability=endless))
    way = ((0.0, 0.0),)
    found = ZoneHoldRules(data)
    assert found
    assert found.find_zone_hold(way, 40.0, 600.0, START_S + 4200.0) is None  # stays at the depot
    assert held(data)
