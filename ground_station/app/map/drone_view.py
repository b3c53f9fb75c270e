"""One drone for the map: its state, assignment, uploaded route and latest decision."""

import math
from dataclasses import dataclass
from typing import Any

from companion.core.base.geo import ne_offset_m
from companion.core.base.location import Location
from companion.core.mission.flight_plan import DROP_TOTAL_S
from companion.core.pilot.transitions import RETURN_PHASES
from companion.fleet.messages import State
from ground_station.adapters.store.decision_reader import ReceivedDecision
from ground_station.app.map.fleet_receiver import VehicleTrack
from ground_station.app.map.picture import DroneShown, Point, RouteShown
from ground_station.app.views.day_content import DayShown
from ground_station.app.views.operator_alerts import prelaunch_silence_reason
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES, STANDBY, VehicleStatus
from ground_station.core.fleet.risk_words import format_decision, format_risk
from ground_station.core.schema.orders import AssignmentRow, Order
from ground_station.core.schema.sortie_rows import SortieRow

ETA_STEP_S = 5.0
"""Expected times are rounded: each change is sent to every client."""

MIN_GROUND_SPEED_MPS = 1.0
RETURN_PHASE_NAMES = frozenset(phase.value for phase in RETURN_PHASES)


@dataclass(frozen=True, slots=True)
class DroneFigures:
    """Figures of a drone of the day, for display."""

    full_wh: float
    reserve_wh: float
    hover_power_w: float
    cruise_airspeed_mps: float
    cruise_height_m: float
    descent_mps: float


@dataclass(frozen=True, slots=True)
class DroneSnapshot:
    """Data on one drone at one moment. `decision`: latest on this flight; `diverted_to`: site of a
    diversion in force; `rally_points`: rally points by name; `depot`: where flights without a truck
    begin and end; `figures`: of its airframe and pack, None: not of the day; `epoch_us`: now.
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
    figures: DroneFigures | None = None
    epoch_us: int = 0

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
        "present": status.is_uniquely_online_and_reporting(t_s),
        "received_us": snapshot.track.received_us,
    }
    state = status.state
    if state is None or silence_reason is not None:
        return DroneShown(phase=silence_reason or "not reported yet", **common)
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
        risk=format_risk(state.p_home, state.p_home_limit),
        risk_now=format_risk(state.p_home_now, state.p_home_limit),
        p_success=state.p_success,
        energy_left_wh=state.energy_left_wh,
        **_energy_fields(state, snapshot.figures),
        **_flight_times_us(snapshot, state),
        diverted_to=snapshot.diverted_to,
        wind_to_ne_mps=None if wind[0] is None or wind[1] is None else (wind[0], wind[1]),
        last_message=state.text,
        decision_text="" if decision is None else format_decision(decision.event.text),
        decision_us=None if decision is None else decision.received_us,
        route=_route_shown(snapshot, state),
        **common_fields,
    )


def _energy_fields(state: State, figures: DroneFigures | None) -> dict[str, Any]:
    spare_wh, left_wh = state.margin_wh, state.energy_left_wh
    needed_wh = None if spare_wh is None or left_wh is None else left_wh - spare_wh
    fields: dict[str, Any] = {"energy_needed_wh": needed_wh}
    if figures is not None:
        fields |= {"full_wh": figures.full_wh, "reserve_wh": figures.reserve_wh}
        fields["spare_min"] = None if spare_wh is None else 60.0 * spare_wh / figures.hover_power_w
    return fields


def _flight_times_us(snapshot: DroneSnapshot, state: State) -> dict[str, Any]:
    """Return launch, and expected drop and landing by the remaining route, rounded to 5 s."""
    sortie, figures, track = snapshot.sortie, snapshot.figures, snapshot.track
    launch_us = track.airborne_since_us if sortie is None else sortie.launched_us
    fields: dict[str, Any] = {"launch_us": launch_us}
    if figures is None or snapshot.position is None or state.phase not in FLIGHT_PHASE_NAMES:
        return fields
    wind = (state.wind_to_n_mps or 0.0, state.wind_to_e_mps or 0.0)
    out, home = _outbound_and_return(snapshot)
    landing = _diversion_landing_position(snapshot)
    height_m = max(state.height_rel_m or 0.0, 0.0)
    seconds = 0.0
    is_outbound = not state.delivered and landing is None and state.phase not in RETURN_PHASE_NAMES
    if is_outbound and out:
        seconds = remaining_flight_s(snapshot.position, out, wind, figures.cruise_airspeed_mps)
        seconds += DROP_TOTAL_S
        fields["drop_us"] = _rounded_us(snapshot.epoch_us, seconds)
        seconds += remaining_flight_s(out[-1], home, wind, figures.cruise_airspeed_mps)
    else:
        way = home if landing is None else [snapshot.position, landing]
        seconds = remaining_flight_s(snapshot.position, way, wind, figures.cruise_airspeed_mps)
    seconds += (height_m if not is_outbound else figures.cruise_height_m) / figures.descent_mps
    fields["land_us"] = _rounded_us(snapshot.epoch_us, seconds)
    return fields


def _rounded_us(now_us: int, seconds: float) -> int:
    return round((now_us / 1e6 + seconds) / ETA_STEP_S) * round(ETA_STEP_S * 1e6)


def remaining_flight_s(
    position: Point, route: list[Point], wind_to_ne_mps: tuple[float, float], airspeed_mps: float
) -> float:
    """Return the time from a position along the rest of a route, from its nearest leg on."""
    if len(route) < 2:
        return 0.0
    ends = [ne_offset_m(*position, *point) for point in route]
    legs = [(ends[k], ends[k + 1]) for k in range(len(ends) - 1)]
    nearest = min(range(len(legs)), key=lambda k: _distance_to_leg_m(*legs[k]))
    rest = [(0.0, 0.0), *ends[nearest + 1 :]]
    return sum(
        _leg_duration_s(rest[k], rest[k + 1], wind_to_ne_mps, airspeed_mps)
        for k in range(len(rest) - 1)
    )


def _distance_to_leg_m(start: tuple[float, float], end: tuple[float, float]) -> float:
    north, east = end[0] - start[0], end[1] - start[1]
    length2 = north * north + east * east
    share = 0.0 if length2 == 0.0 else -(start[0] * north + start[1] * east) / length2
    share = min(1.0, max(0.0, share))
    return math.hypot(start[0] + share * north, start[1] + share * east)


def _leg_duration_s(
    start: tuple[float, float],
    end: tuple[float, float],
    wind_to_ne_mps: tuple[float, float],
    airspeed_mps: float,
) -> float:
    north, east = end[0] - start[0], end[1] - start[1]
    length_m = math.hypot(north, east)
    if length_m == 0.0:
        return 0.0
    along = (wind_to_ne_mps[0] * north + wind_to_ne_mps[1] * east) / length_m
    across = (wind_to_ne_mps[0] * east - wind_to_ne_mps[1] * north) / length_m
    speed_mps = math.sqrt(max(airspeed_mps**2 - across**2, 0.0)) + along
    return length_m / max(speed_mps, MIN_GROUND_SPEED_MPS)


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
