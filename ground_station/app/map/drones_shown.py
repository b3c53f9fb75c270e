"""One drone for the map: its state, its assignment, the way that is aboard, its last decision."""

from dataclasses import dataclass
from typing import Any

from companion.core.base.place import Place
from companion.fleet.messages import State
from ground_station.adapters.store.decision_reader import HeardDecision
from ground_station.app.map.fleet_ear import VehicleTrack
from ground_station.app.map.picture import DroneShown, Point, WayShown
from ground_station.app.views.attention import expected_silence, vehicle_alarms
from ground_station.app.views.watched_rows import DayShown
from ground_station.core.fleet.fleet_status import STANDBY, VehicleStatus
from ground_station.core.schema.orders import AssignmentRow, Order
from ground_station.core.schema.sortie_rows import SortieRow


@dataclass(frozen=True, slots=True)
class DroneFacts:
    """What is known of one drone at one moment. `decision`: the last on this flight;
    `diverted_to`: the place of a diversion in force; `places`: rally points by name, `depot`:
    where flights without a truck begin and end.
    """

    seen: VehicleStatus
    track: VehicleTrack
    row: AssignmentRow | None
    order: Order | None
    day: DayShown | None
    decision: HeardDecision | None
    diverted_to: str | None
    depot: Point | None
    places: dict[str, Point]

    @property
    def sortie(self) -> SortieRow | None:
        """Its sortie from a truck."""
        return None if self.day is None else self.day.sortie(self.seen.vehicle)

    @property
    def at(self) -> Point | None:
        """Where it is."""
        state = self.seen.state
        if state is None or state.lat_deg is None or state.lon_deg is None:
            return None
        return state.lat_deg, state.lon_deg


def drone_shown(facts: DroneFacts, t_s: float) -> DroneShown:
    """One drone at this time of the monotonic clock."""
    seen, row, sortie = facts.seen, facts.row, facts.sortie
    off = expected_silence(seen, facts.day)
    common: dict[str, Any] = {
        "order": None if row is None else row.order_id,
        "home": None if sortie is None else sortie.promised,
        "asked": None if sortie is None else sortie.asked,
        "alarms": list(vehicle_alarms(seen, facts.day, t_s)),
        "present": seen.present(t_s),
        "heard_us": facts.track.heard_us,
    }
    state = seen.state
    if state is None or off is not None:
        return DroneShown(phase=off or "not heard", **common)
    return _flying(facts, state, common)


def _flying(facts: DroneFacts, state: State, common: dict[str, Any]) -> DroneShown:
    decision, wind = facts.decision, (state.wind_to_n_mps, state.wind_to_e_mps)
    return DroneShown(
        phase=_phase(facts, state),
        at=facts.at,
        height_rel_m=state.height_rel_m,
        course_deg=facts.track.course_deg,
        ground_speed_mps=state.ground_speed_mps,
        delivered=state.delivered,
        armed=bool(state.armed),
        margin_wh=state.margin_wh,
        p_home=state.p_home,
        p_home_now=state.p_home_now,
        p_success=state.p_success,
        energy_left_wh=state.energy_left_wh,
        wind_to_ne_mps=None if wind[0] is None or wind[1] is None else (wind[0], wind[1]),
        says=state.text,
        why="" if decision is None else decision.event.text,
        why_us=None if decision is None else decision.heard_us,
        way=_way(facts, state),
        **common,
    )


def _phase(facts: DroneFacts, state: State) -> str:
    sortie = facts.sortie
    return "down, take it in" if sortie is not None and sortie.over else state.phase


def _way(facts: DroneFacts, state: State) -> WayShown:
    """The way of the mission that is aboard; where it is not told, the assignment's legs."""
    if state.assignment is None or state.phase == STANDBY:
        return WayShown()
    at, asked, landing = facts.at, _pad(facts, "asked"), _landing(facts)
    out, home = _legs(facts)
    return WayShown(
        straight=facts.track.route is None and bool(out or home),
        out=[] if state.delivered else out,
        home=[] if landing is not None else home,
        asked=[] if asked is None or at is None else [at, asked],
        now=[] if landing is None or at is None else [at, landing],
    )


def _legs(facts: DroneFacts) -> tuple[list[Point], list[Point]]:
    """Out and home: the route's, or straight lines between pads and customer."""
    route, order = facts.track.route, facts.order
    if route is not None:
        return list(route.out), list(route.home)
    if order is None:
        return [], []
    customer = (order.lat_deg, order.lon_deg)
    start, end = _pad(facts, "launch"), _pad(facts, "promised")
    out = [] if start is None else [start, customer]
    return out, [] if end is None else [customer, end]


def _pad(facts: DroneFacts, which: str) -> Point | None:
    sortie = facts.sortie
    if sortie is None:
        return None if which == "asked" else facts.depot
    names = {
        "launch": sortie.sortie.launch,
        "promised": sortie.promised,
        "asked": sortie.asked,
    }
    return point_of(sortie.pads.get(names[which] or ""))


def _landing(facts: DroneFacts) -> Point | None:
    """Where a diversion in force lands."""
    name, route = facts.diverted_to or "", facts.track.route
    pads = {} if facts.sortie is None else facts.sortie.pads
    aboard = {} if route is None else route.places
    return facts.places.get(name) or point_of(pads.get(name)) or aboard.get(name)


def point_of(place: Place | None) -> Point | None:
    """A geodetic place's point."""
    if place is None or place.lat_deg is None or place.lon_deg is None:
        return None
    return place.lat_deg, place.lon_deg
