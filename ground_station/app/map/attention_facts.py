"""Facts of one moment for the attention list."""

from collections.abc import Mapping

from companion.core.base.geo import ne_offset_m
from ground_station.app.map.drone_view import point_of_location
from ground_station.app.map.map_snapshot import MapSnapshot
from ground_station.app.map.picture import DroneShown, Point, SiteShown
from ground_station.app.views.day_content import DayShown, DisplayRows
from ground_station.app.views.operator_alerts import prelaunch_silence_reason, stuck_order_texts
from ground_station.core.fleet.attention import FleetFacts, LaunchFacts, VehicleFacts
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES, VehicleStatus
from ground_station.core.fleet.risk_words import format_reason
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.order_window import late_text
from ground_station.core.schema.orders import AssignmentState


def fleet_facts(
    snapshot: MapSnapshot, drones: Mapping[str, DroneShown], site: SiteShown
) -> FleetFacts:
    """Return the facts."""
    rows, t_s = snapshot.store.rows, snapshot.t_s
    places = named_places(rows.day, site)
    names = [*([TRUCK] if TRUCK in snapshot.status.vehicles else []), *drones]
    return FleetFacts(
        vehicles=[
            _vehicle_facts(snapshot.status.status_of(n), drones.get(n), rows.day, t_s, places)
            for n in names
        ],
        launches=_launches(rows, drones),
        stuck=[(order, _stuck_reason(text)) for order, text in stuck_order_texts(rows.orders)],
        idle_reasons={name: format_reason(why) for name, why in rows.idle_reasons.items()},
        late={**rows.late_orders, **_late_in_flight(snapshot, drones)},
        held={hold.scope for hold in rows.hold_list},
        out_of_service={h.scope: h.text for h in rows.hold_list if h.is_out_of_service},
        handover=rows.handover,
        desk_silence_s=snapshot.desk_silence_s,
        desk_alarm=snapshot.desk_alarm,
        store_error=snapshot.store_error,
        roster_alarm=snapshot.roster_alarm,
        certificates=snapshot.expiring_certificates,
        fronts=snapshot.front_texts,
        stations=snapshot.station_texts,
    )


def _late_in_flight(snapshot: MapSnapshot, drones: Mapping[str, DroneShown]) -> dict[str, str]:
    """Return the orders in the air that are dropped after their window."""
    late: dict[str, str] = {}
    for name, drone in drones.items():
        order = snapshot.store.orders.get(drone.order or "")
        if order is None or drone.drop_us is None or drone.delivered:
            continue
        if text := late_text(order.window, drone.drop_us, f"by {name}"):
            late[order.id] = text
    return late


def named_places(day: DayShown | None, site: SiteShown) -> dict[str, Point]:
    """Return the depot, stops and rally points by name."""
    places = dict(site.rally)
    for stop in () if day is None else day.plan.stops:
        if (at := point_of_location(stop.location)) is not None:
            places[stop.id] = at
    return places | ({} if site.depot is None else {"the depot": site.depot})


def position_text(at: Point | None, places: Mapping[str, Point]) -> str:
    """Return a position relative to the nearest named place; empty: unknown."""
    if at is None or not places:
        return ""
    far_m = {name: _distance_m(at, place) for name, place in places.items()}
    name = min(far_m, key=lambda one: far_m[one])
    return f"at {name}" if far_m[name] < 10.0 else f"{10 * round(far_m[name] / 10)} m from {name}"


def _distance_m(one: Point, other: Point) -> float:
    north_m, east_m = ne_offset_m(*one, *other)
    return (north_m**2 + east_m**2) ** 0.5


def _vehicle_facts(
    status: VehicleStatus,
    drone: DroneShown | None,
    day: DayShown | None,
    t_s: float,
    places: Mapping[str, Point],
) -> VehicleFacts:
    state = status.state
    faults = [*status.doubts, *([state.monitor_text] if state and state.monitor_text else [])]
    return VehicleFacts(
        name=status.vehicle,
        contact_age_s=status.seconds_since_last_state(t_s),
        is_online=bool(status.instance_ids),
        is_expected=prelaunch_silence_reason(status, day) is None,
        is_airborne=state is not None and (state.phase in FLIGHT_PHASE_NAMES or bool(state.armed)),
        is_on_flight=state is not None and bool(state.armed and state.assignment),
        spare_wh=None if state is None else state.margin_wh,
        spare_min=None if drone is None else drone.spare_min,
        last_position="" if drone is None else position_text(drone.position, places),
        height_rel_m=None if state is None else state.height_rel_m,
        land_us=None if drone is None else drone.land_us,
        diverted_to=None if drone is None else drone.diverted_to,
        faults=faults,
    )


def _launches(rows: DisplayRows, drones: Mapping[str, DroneShown]) -> list[LaunchFacts]:
    """Return launches that the desk has asked to confirm and that still wait."""
    return [
        LaunchFacts(row.order_id, row.vehicle, drones[row.vehicle].risk)
        for row in rows.assignments
        if row.id in rows.launch_requests
        and row.state is AssignmentState.UPLOADED
        and row.confirmed_by is None
        and row.vehicle in drones
    ]


def _stuck_reason(text: str) -> str:
    return format_reason(text.removeprefix("is stuck: ").rstrip("."))
