"""A planned sortie as the vehicle is assigned it: its `flight/1`."""

from typing import Any

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import Flight, Site, Vehicle
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.order_parsing import place_of

ANY_CHARGE = [0.05, 1.0]
"""The desk does not know the charge of a pack: the companion finds it out at rest."""


def flight_of(data: DayData, plan: DayPlan, sortie: PlannedSortie) -> Flight:
    """The flight: from its launch pad, in its layer, home to the stop that is promised.

    Its pads at home and at `others` are the stops aboard. Obstacles travel beside it.
    """
    day = data.day
    drone = day.drone(sortie.vehicle)
    order = next((order for order in data.orders if order.id == sortie.order), None)
    if drone is None or order is None:
        raise LeewayError(f"{sortie.vehicle} with {sortie.order}: not in the day's files")
    pads = [(id_, plan.stop(id_).pads[sortie.vehicle]) for id_ in (sortie.home, *sortie.others)]
    return Flight(
        format="flight/1",
        name=order.id,
        site=Site(
            depot=msgspec.structs.replace(plan.stop(sortie.launch).pads[sortie.vehicle], name=""),
            customer=place_of(order),
            rally=day.rally,
            stops=[msgspec.structs.replace(pad, name=id_) for id_, pad in pads],
            home=sortie.home,
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


def flight_table(flight: Flight) -> dict[str, Any]:
    """As an `Assign` carries it: plain values, without what is not set."""
    return _bare(msgspec.to_builtins(flight))


def _bare(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _bare(v) for k, v in value.items() if v is not None and (k, v) != ("up_m", 0.0)}
    if isinstance(value, list):
        return [_bare(item) for item in value]
    return value
