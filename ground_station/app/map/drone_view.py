"""One drone for the map: its state, assignment, uploaded route and latest decision."""

from dataclasses import dataclass
from typing import Any

from companion.core.base.location import Location
from companion.fleet.messages import State
from ground_station.adapters.store.decision_reader import ReceivedDecision
from ground_station.app.map.fleet_receiver import VehicleTrack
from ground_station.app.map.picture import DroneShown, Point, RouteShown
from ground_station.app.views.day_content import DayShown
from ground_station.app.views.operator_alerts import prelaunch_silence_reason, vehicle_alarm_texts
from ground_station.core.fleet.fleet_status import STANDBY, VehicleStatus
from ground_station.core.schema.orders import AssignmentRow, Order
from ground_station.core.schema.sortie_rows import SortieRow


@dataclass(frozen=True, slots=True)
class DroneSnapshot:
    """Data on one drone at one moment. `decision`: latest on this flight; `diverted_to`: site of a
    diversion in force; `rally_points`: rally points by name; `depot`: where flights without a truck
    begin and end.
    """

    status: VehicleStatus
    track: VehicleTrack
    assignment: AssignmentRow | None
    order: Order | None
    day: DayShown | None
    decision: ReceivedDecision | None
    diverted_to: str | None
    depot: Point | None
    rally_points: dict[str, Point]

    @property
    def sortie(self) -> SortieRow | None:
        """Its sortie from a truck."""
        return None if self.day is None else self.day.active_sortie_of(self.status.vehicle)

    @property
    def position(self) -> Point | None:
        """Its position."""
        state = self.status.state
        if state is None or state.lat_deg is None or state.lon_deg is None:
            return None
        return state.lat_deg, state.lon_deg


def drone_shown(snapshot: DroneSnapshot, t_s: float) -> DroneShown:
    """Return one drone at this time of the monotonic clock."""
    status, row, sortie = snapshot.status, snapshot.assignment, snapshot.sortie
    silence_reason = prelaunch_silence_reason(status, snapshot.day)
    common: dict[str, Any] = {
        "order": None if row is None else row.order_id,
        "home": None if sortie is None else sortie.promised_stop,
        "requested_stop": None if sortie is None else sortie.requested_stop,
        "alarms": list(vehicle_alarm_texts(status, snapshot.day, t_s)),
        "present": status.is_uniquely_online_and_reporting(t_s),
        "received_us": snapshot.track.received_us,
    }
    state = status.state
    if state is None or silence_reason is not None:
        return DroneShown(phase=silence_reason or "no contact", **common)
    return _drone_with_state_shown(snapshot, state, common)


def _drone_with_state_shown(
    snapshot: DroneSnapshot, state: State, common_fields: dict[str, Any]
) -> DroneShown:
    decision, wind = snapshot.decision, (state.wind_to_n_mps, state.wind_to_e_mps)
    return DroneShown(
        phase=_phase_text(snapshot, state),
        position=snapshot.position,
        height_rel_m=state.height_rel_m,
        course_deg=snapshot.track.course_deg,
        ground_speed_mps=state.ground_speed_mps,
        delivered=state.delivered,
        armed=bool(state.armed),
        margin_wh=state.margin_wh,
        p_home=state.p_home,
        p_home_limit=state.p_home_limit or None,
        p_home_now=state.p_home_now,
        p_success=state.p_success,
        energy_left_wh=state.energy_left_wh,
        wind_to_ne_mps=None if wind[0] is None or wind[1] is None else (wind[0], wind[1]),
        last_message=state.text,
        decision_text="" if decision is None else decision.event.text,
        decision_us=None if decision is None else decision.received_us,
        route=_route_shown(snapshot, state),
        **common_fields,
    )


def _phase_text(snapshot: DroneSnapshot, state: State) -> str:
    sortie = snapshot.sortie
    return "landed, recover it" if sortie is not None and sortie.is_finished else state.phase


def _route_shown(snapshot: DroneSnapshot, state: State) -> RouteShown:
    """Return the route of the uploaded mission; if not reported, that of the assignment."""
    if state.assignment is None or state.phase == STANDBY:
        return RouteShown()
    position = snapshot.position
    requested_stop = _pad_position(snapshot, "asked")
    landing = _diversion_landing_position(snapshot)
    out, home = _outbound_and_return(snapshot)
    return RouteShown(
        is_straight=snapshot.track.route is None and bool(out or home),
        outbound=[] if state.delivered else out,
        home=[] if landing is not None else home,
        to_requested_stop=[]
        if requested_stop is None or position is None
        else [position, requested_stop],
        diversion=[] if landing is None or position is None else [position, landing],
    )


def _outbound_and_return(snapshot: DroneSnapshot) -> tuple[list[Point], list[Point]]:
    """Return outbound and return points: the route's, or straight lines via the customer."""
    route, order = snapshot.track.route, snapshot.order
    if route is not None:
        return list(route.outbound), list(route.homebound)
    if order is None:
        return [], []
    customer = (order.lat_deg, order.lon_deg)
    start, end = _pad_position(snapshot, "launch"), _pad_position(snapshot, "promised")
    out = [] if start is None else [start, customer]
    return out, [] if end is None else [customer, end]


def _pad_position(snapshot: DroneSnapshot, pad_role: str) -> Point | None:
    sortie = snapshot.sortie
    if sortie is None:
        return None if pad_role == "asked" else snapshot.depot
    names = {
        "launch": sortie.sortie.launch,
        "promised": sortie.promised_stop,
        "asked": sortie.requested_stop,
    }
    return point_of_location(sortie.pads.get(names[pad_role] or ""))


def _diversion_landing_position(snapshot: DroneSnapshot) -> Point | None:
    """Return the landing point of a diversion in force."""
    name, route = snapshot.diverted_to or "", snapshot.track.route
    pads = {} if snapshot.sortie is None else snapshot.sortie.pads
    mission_positions = {} if route is None else route.landing_positions
    return (
        snapshot.rally_points.get(name)
        or point_of_location(pads.get(name))
        or mission_positions.get(name)
    )


def point_of_location(location: Location | None) -> Point | None:
    """Return the map point of a geodetic position."""
    if location is None or location.lat_deg is None or location.lon_deg is None:
        return None
    return location.lat_deg, location.lon_deg
