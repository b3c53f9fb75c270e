"""The `flight/1` table of an order or a planned sortie, as assigned to its vehicle."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.location import Location
from companion.core.mission.flight_file import Flight, Mission
from ground_station.core.schema.day import Day, Drone
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.orders import Order, order_location

UNKNOWN_CHARGE_RANGE = [0.05, 1.0]
"""Charge range for an unknown pack: the companion measures the charge at rest."""

NeighbourKeys = Callable[[str], Mapping[str, str]]
"""The public keys of a neighbouring fleet's vehicles, by name."""


def no_neighbour_keys(fleet: str) -> Mapping[str, str]:
    """Return no keys, for a network without identities."""
    return {}


def depot_delivery_flight_table(
    day: Day, drone: Drone, order: Order, elevation: SiteElevation | None = None
) -> dict[str, Any]:
    """Return a delivery from the depot and back as the table of an `Assign` command.

    With `elevation` it contains the ground along its route.
    """
    site = {"depot": day.depot.location, "customer": order_location(order), "rally": day.rally}
    air_temperature_c = day.forecast.air_temperature_c
    air = {} if air_temperature_c is None else {"air_temperature_c": air_temperature_c}
    return {
        "format": "flight/1",
        "name": order.id,
        "site": {key: _to_builtins_without_unset_fields(value) for key, value in site.items()}
        | air
        | _terrain_table(day, elevation, day.depot.location, [order_location(order), *day.rally]),
        "vehicle": {
            "airframe": drone.airframe,
            "payload_kg": order.mass_kg,
            "charge_frac": UNKNOWN_CHARGE_RANGE,
            "temperature_c": drone.temperature_c,
            "battery_health_frac": drone.battery_health_frac,
        },
        "mission": _mission_table(day.mission, elevation),
    } | ({"neighbours": [{"fleet": name} for name in day.neighbours]} if day.neighbours else {})


def with_neighbour_keys(
    flight_table: dict[str, Any], get_neighbour_keys: NeighbourKeys
) -> dict[str, Any]:
    """Return the table with the neighbours' current public keys: the flight accepts the tracks that
    these vehicles sign.
    """
    neighbour_tables = [
        one | {"keys": dict(get_neighbour_keys(one["fleet"]))}
        for one in flight_table.get("neighbours", [])
    ]
    return flight_table | {"neighbours": neighbour_tables} if neighbour_tables else flight_table


def sortie_flight_table(
    day: Day,
    drone: Drone,
    order: Order,
    sortie: PlannedSortie,
    pad_by_stop: Mapping[str, Location],
    elevation: SiteElevation | None = None,
) -> dict[str, Any]:
    """Return a sortie from a stop to its promised stop as the table of an `Assign` command.

    `pad_by_stop`: candidate landing pads, by stop.
    """
    table = depot_delivery_flight_table(day, drone, order)
    mission = msgspec.structs.replace(
        day.mission,
        cruise_height_m=sortie.outbound_height_m,
        return_height_m=sortie.return_height_m,
    )
    stops = [msgspec.structs.replace(location, name=stop) for stop, location in pad_by_stop.items()]
    locations = [order_location(order), *day.rally, *stops]
    site = table["site"] | {
        "depot": _to_builtins_without_unset_fields(
            msgspec.structs.replace(pad_by_stop[sortie.launch], name="pad")
        ),
        "stops": _to_builtins_without_unset_fields(stops),
        "home": sortie.home,
    }
    site |= _terrain_table(day, elevation, pad_by_stop[sortie.launch], locations)
    return table | {"site": site, "mission": _mission_table(mission, elevation)}


def flight_from_planned_sortie(data: DayData, plan: DayPlan, sortie: PlannedSortie) -> Flight:
    """Return a planned sortie as a flight: from its launch pad, in its layer, to the promised stop.

    Its uploaded stops are the pads at home and at `alternative_stops`. Obstacles are sent
    separately.
    """
    drone = data.day.find_drone(sortie.vehicle)
    order = next((order for order in data.orders if order.id == sortie.order), None)
    if drone is None or order is None:
        raise LeewayError(f"{sortie.vehicle} with {sortie.order}: not in the day's files")
    stops = (sortie.home, *sortie.alternative_stops)
    pads = {id_: plan.get_stop(id_).pads[sortie.vehicle] for id_ in (sortie.launch, *stops)}
    table = sortie_flight_table(data.day, drone, order, sortie, pads, data.elevation)
    flight = msgspec.convert(table, Flight)
    assert flight.site.depot is not None
    site = msgspec.structs.replace(
        flight.site,
        depot=msgspec.structs.replace(flight.site.depot, name=""),
        stops=[msgspec.structs.replace(pads[id_], name=id_) for id_ in stops],
    )
    return msgspec.structs.replace(flight, site=site)


def _terrain_table(
    day: Day, elevation: SiteElevation | None, depot: Location, locations: Sequence[Location]
) -> dict[str, Any]:
    """Return the ground of the tiles, else the plane that the day states (flat: without slope)."""
    if elevation is None:
        ground = day.depot.stated_plane
        return {} if ground is None else {"terrain": _to_builtins_without_unset_fields(ground)}
    heights = elevation.ground_table_along_route(depot, locations)
    return {"terrain": {"kind": "grid", "heights": msgspec.to_builtins(heights)}}


def _mission_table(mission: Mission, elevation: SiteElevation | None) -> dict[str, Any]:
    """Return the mission table, without clearance if no ground is known and without an empty list
    of authorised geo-zones: older vehicles do not know these keys.
    """
    table = _to_builtins_without_unset_fields(mission)
    if not mission.authorised_zones:
        del table["authorised_zones"]
    if elevation is None:
        del table["clearance_m"]
    return table


def _to_builtins_without_unset_fields(value: Any) -> Any:
    """Return built-in values, without unset fields."""
    if isinstance(value, list):
        return [_to_builtins_without_unset_fields(item) for item in value]
    table = msgspec.to_builtins(value)
    return {k: v for k, v in table.items() if v is not None and (k, v) != ("up_m", 0.0)}
