"""The `flight/1` of an order or a planned sortie, as its vehicle is assigned it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.place import Place
from companion.core.mission.flight_file import (
    Flight,
    Mission,
    NeighbourFleet,
    Site,
    Vehicle,
    with_heights,
)
from ground_station.core.schema.day import Day, Drone
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.orders import Order, place_of

ANY_CHARGE = [0.05, 1.0]
"""The desk does not know the charge of a pack: the companion measures it at rest."""

NeighbourKeys = Callable[[str], Mapping[str, str]]
"""The public keys of a neighbouring fleet's vehicles, by name."""


def no_keys(fleet: str) -> Mapping[str, str]:
    """Without identities nobody has one."""
    return {}


def delivery_table(
    day: Day, drone: Drone, order: Order, elevation: SiteElevation | None = None
) -> dict[str, Any]:
    """A delivery from the depot and back, as the table of an `Assign` command.

    With `elevation` it carries the ground along its way.
    """
    site = {"depot": day.depot.place, "customer": place_of(order), "rally": day.rally}
    stated_c = day.forecast.air_temperature_c
    air = {} if stated_c is None else {"air_temperature_c": stated_c}
    return {
        "format": "flight/1",
        "name": order.id,
        "site": {key: _plain(value) for key, value in site.items()}
        | air
        | _terrain(elevation, day.depot.place, [place_of(order), *day.rally]),
        "vehicle": {
            "airframe": drone.airframe,
            "payload_kg": order.mass_kg,
            "charge_frac": ANY_CHARGE,
            "temperature_c": drone.temperature_c,
            "battery_health_frac": drone.battery_health_frac,
        },
        "mission": _mission(day.mission, elevation),
    } | ({"neighbours": [{"fleet": name} for name in day.neighbours]} if day.neighbours else {})


def with_neighbour_keys(table: dict[str, Any], keys_of: NeighbourKeys) -> dict[str, Any]:
    """The same with what the desk knows now of its neighbours' vehicles: whose tracks are believed
    on this flight.
    """
    told = [one | {"keys": dict(keys_of(one["fleet"]))} for one in table.get("neighbours", [])]
    return table | {"neighbours": told} if told else table


def sortie_table(
    day: Day,
    drone: Drone,
    order: Order,
    sortie: PlannedSortie,
    pads: Mapping[str, Place],
    elevation: SiteElevation | None = None,
) -> dict[str, Any]:
    """A sortie from a stop of the truck to the stop that it promises, as the table of an `Assign`.

    `pads`: where it may land, by stop.
    """
    table = delivery_table(day, drone, order)
    mission = msgspec.structs.replace(
        day.mission,
        cruise_height_m=sortie.outbound_height_m,
        return_height_m=sortie.return_height_m,
    )
    stops = [msgspec.structs.replace(place, name=stop) for stop, place in pads.items()]
    places = [place_of(order), *day.rally, *stops]
    site = table["site"] | {
        "depot": _plain(msgspec.structs.replace(pads[sortie.launch], name="pad")),
        "stops": _plain(stops),
        "home": sortie.home,
    }
    site |= _terrain(elevation, pads[sortie.launch], places)
    return table | {"site": site, "mission": _mission(mission, elevation)}


def planned_flight(data: DayData, plan: DayPlan, sortie: PlannedSortie) -> Flight:
    """A sortie as the plan has it: from its launch pad, in its layer, home to the promised stop.

    Its pads at home and at `others` are the stops aboard. Obstacles travel beside the flight.
    """
    day, elevation = data.day, data.elevation
    drone = day.drone(sortie.vehicle)
    order = next((order for order in data.orders if order.id == sortie.order), None)
    if drone is None or order is None:
        raise LeewayError(f"{sortie.vehicle} with {sortie.order}: not in the day's files")
    pads = [(id_, plan.stop(id_).pads[sortie.vehicle]) for id_ in (sortie.home, *sortie.others)]
    launch = plan.stop(sortie.launch).pads[sortie.vehicle]
    places = [place_of(order), *day.rally, *(pad for _, pad in pads)]
    flight = Flight(
        format="flight/1",
        name=order.id,
        neighbours=[NeighbourFleet(fleet=name) for name in day.neighbours],
        site=Site(
            depot=msgspec.structs.replace(launch, name=""),
            customer=place_of(order),
            rally=day.rally,
            stops=[msgspec.structs.replace(pad, name=id_) for id_, pad in pads],
            home=sortie.home,
            air_temperature_c=day.forecast.air_temperature_c,
        ),
        vehicle=Vehicle(
            airframe=drone.airframe,
            payload_kg=order.mass_kg,
            charge_frac=ANY_CHARGE,
            temperature_c=drone.temperature_c,
            battery_health_frac=drone.battery_health_frac,
        ),
        mission=msgspec.structs.replace(
            day.mission,
            cruise_height_m=sortie.outbound_height_m,
            return_height_m=sortie.return_height_m,
        ),
    )
    return with_heights(flight, None if elevation is None else elevation.strip(launch, places))


def _terrain(
    elevation: SiteElevation | None, depot: Place, places: Sequence[Place]
) -> dict[str, Any]:
    if elevation is None:
        return {}
    heights = elevation.strip(depot, places)
    return {"terrain": {"kind": "grid", "heights": msgspec.to_builtins(heights)}}


def _mission(mission: Mission, elevation: SiteElevation | None) -> dict[str, Any]:
    """Without a clearance where no ground is told, and leave for no geo-zone: older vehicles do not
    know the keys.
    """
    table = _plain(mission)
    if not mission.authorised_zones:
        del table["authorised_zones"]
    if elevation is None:
        del table["clearance_m"]
    return table


def _plain(value: Any) -> Any:
    """Plain values, without what is not set."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    table = msgspec.to_builtins(value)
    return {k: v for k, v in table.items() if v is not None and (k, v) != ("up_m", 0.0)}
