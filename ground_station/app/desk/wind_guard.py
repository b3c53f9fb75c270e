"""The desk's watch over the wind: it says what the field is, holds launches that a front would
catch or that wind aloft forbids, lifts these holds itself, and judges anew who flies into a front.

A hold is in the store before anything is launched past it. A person may release one: it is not set
again for the same reason.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from companion.core.base.geo import Ned, place_ned
from companion.core.base.place import Place
from companion.core.mission.flight_plan import frame_at
from companion.core.wind_field.fronts import FrontAhead, FrontNews, FrontWithdrawn
from companion.fleet.messages import State
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.forecast_watch import ForecastWatch
from ground_station.app.desk.station_desk import StationDesk
from ground_station.core.deconfliction.depot_layers import DepotLayers
from ground_station.core.dispatch.wind_holds import (
    HELD_BY,
    Launch,
    WindHolds,
    longest_s,
    would_catch,
)
from ground_station.core.dispatch.zone_holds import ZoneHolds
from ground_station.core.feasibility.flight_in_front import FlightNow, judged
from ground_station.core.feasibility.reach import Reach, day_energy
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.route_aboard import route_of
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.planning.day_problem import TOP_M
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.holds import ALL
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, Order, place_of
from ground_station.core.schema.sortie_rows import SortieRow
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_words import field_words, front_words, withdrawn_words

SAY_S = 300.0
"""What the field is stands in the log so often, and when somebody is left out or back in."""

AFTER_RESTART_S = 600.0
"""A desk that starts knows nothing of the fronts of before: its holds of then end so long after
they were set.
"""

BEHIND_STD_MPS = 2.0
"""Error of the wind behind a front on each axis, away from who felt it: as a day's forecast."""

TO_LAUNCH = (AssignmentState.ORDERED, AssignmentState.ABOARD)

Places = tuple[tuple[float, float], ...]


@dataclass(slots=True)
class WindGuard:
    """One desk's. `sorties`: of a day with a truck, where its drones land. `forecast`: watches over
    one that is followed; None: the day has none. `stations`: what wind stations tell.
    """

    store: Store
    data: DayData
    holds: WindHolds
    clock: Clock
    say: Callable[[str], None]
    sorties: Callable[[], Sequence[SortieRow]] = lambda: ()
    forecast: ForecastWatch | None = None
    stations: StationDesk | None = None
    zones: ZoneHolds = field(init=False)
    _layers: DepotLayers = field(init=False)
    _held: set[str] = field(default_factory=set)
    _keep_until_s: dict[str, float] = field(default_factory=dict)
    _began: bool = False
    _to_tell: list[FrontNews] = field(default_factory=list)
    _said_s: float = -math.inf
    _out: frozenset[str] = frozenset()
    _reach: dict[str, Reach] = field(default_factory=dict)
    _orders: dict[str, Order] = field(default_factory=dict)
    _sorties: dict[str, SortieRow] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.zones = ZoneHolds(self.data)
        self._layers = DepotLayers(self.data.day.mission, TOP_M)

    @property
    def wind(self) -> SiteWind:
        """The field."""
        return self.holds.wind

    def on_state(self, state: State) -> None:
        """Take a state that a member has published."""
        front = self.wind.on_state(state, self.clock.monotonic_s())
        if front is not None:
            self._to_tell.append(front)

    def on_station(self, told: StationWind) -> None:
        """Take what a wind station has told on the network."""
        if self.stations is not None:
            self._to_tell += self.stations.take(told)

    def turn(self, status: FleetStatus) -> bool:
        """Do what is due; whether a hold was set or lifted. Raises StoreError where it is away."""
        now_s = self.clock.monotonic_s()
        self._begin(now_s)
        if self.stations is not None:
            self._to_tell += self.stations.turn(now_s)
        self._say_field(now_s)
        if self.forecast is not None:
            self.forecast.turn(now_s)
        wanted = self.forecast is not None or self.zones or self.wind.fronts_now(now_s)
        rows = self._read_rows() if wanted else []
        waiting = [row for row in rows if row.state in TO_LAUNCH]
        launches = [self._launch(row, status) for row in waiting]
        due = self._zones_due(waiting, launches, status) | self.holds.due(now_s, launches)
        if self.forecast is not None:
            due = self.forecast.held(waiting, self._orders, self._sorties, now_s) | due
        changed = self._hold(due, now_s)
        while self._to_tell:
            news = self._to_tell[0]
            if isinstance(news, FrontWithdrawn):
                self.say(withdrawn_words(news))
            else:
                self._tell(news, rows, status, now_s)
            self._to_tell.pop(0)
        return changed

    def close(self) -> None:
        """Stop what runs beside the desk."""
        if self.forecast is not None and self.forecast.file is not None:
            self.forecast.file.close()

    def _zones_due(
        self, rows: Sequence[AssignmentRow], launches: Sequence[Launch], status: FleetStatus
    ) -> dict[str, str]:
        """Who is held for a geo-zone that comes in force while its flight, drawn out, is out."""
        if not self.zones:
            return {}
        now_s, found = self.clock.epoch_us() / 1e6, dict[str, str]()
        for row, launch in zip(rows, launches, strict=True):
            way = self._told_way(row, status) or launch.places_ne_m
            held = self.zones.held(way, self._highest_m(row), launch.takes_s, now_s)
            if held is not None:
                found[row.vehicle] = held.words
        return found

    def _told_way(self, row: AssignmentRow, status: FleetStatus) -> Places:
        """The way of the mission aboard, as its vehicle tells it; empty: it does not."""
        state = status.of(row.vehicle).state
        route = None if state is None or state.assignment != row.id else route_of(state)
        if route is None:
            return ()
        return tuple(self.wind.place_ne_m(*place) for place in (*route.out, *route.home))

    def _highest_m(self, row: AssignmentRow) -> float:
        """Level flight above the depot; over known ground it may be lifted to any height."""
        if self.data.elevation is not None:
            return math.inf
        sortie = self._sorties.get(row.id)
        if sortie is None:
            return self._layers.band_m(row.layer or 0)[1]
        plan, pad = sortie.sortie, sortie.pads[sortie.sortie.launch]
        return max(plan.outbound_height_m, plan.return_height_m) - self._ground(pad)[2]

    def _read_rows(self) -> list[AssignmentRow]:
        """Drones' assignments in force, with what is needed to know their ways."""
        rows = [r for r in self.store.assignments(in_force=True) if r.vehicle != TRUCK]
        wanted = {row.order_id for row in rows}
        known = {name: order for name, order in self._orders.items() if name in wanted}
        if new := wanted - known.keys():
            known |= {o.order.id: o.order for o in self.store.orders_named(new)}
        self._orders = known
        self._sorties = {sortie.id: sortie for sortie in self.sorties()} if rows else {}
        return rows

    # --- holds ---------------------------------------------------------------------------------

    def _begin(self, now_s: float) -> None:
        """Holds of ours from before a restart end by themselves, too."""
        if self._began:
            return
        for hold in self.store.holds():
            if hold.by == HELD_BY:
                age_s = max(0.0, (self.clock.epoch_us() - hold.set_us) / 1e6)
                self._held.add(hold.scope)
                self._keep_until_s[hold.scope] = now_s + max(0.0, AFTER_RESTART_S - age_s)
        self._began = True

    def _hold(self, due: dict[str, str], now_s: float) -> bool:
        new = due.keys() - self._held
        over = {
            scope
            for scope in self._held - due.keys()
            if now_s >= self._keep_until_s.get(scope, -math.inf)
        }
        if not new and not over:
            return False
        holds = HoldStore(self.store.database, self.clock.epoch_us)
        in_force = {hold.scope for hold in self.store.holds() if hold.by == HELD_BY}
        for scope in sorted(new):
            if scope not in in_force:  # another desk of this store may have set it
                self._set(holds, scope, due[scope])
            self._held.add(scope)
        for scope in sorted(over):
            lifted = holds.release([scope], HELD_BY, only_own=True)
            self._held.discard(scope)
            self._keep_until_s.pop(scope, None)
            for hold in lifted:
                what = "" if hold.reason.startswith("zone ") else " for the wind"
                self.say(f"{_name(scope)}: no longer held{what} ({hold.reason})")
        return True

    def _set(self, holds: HoldStore, scope: str, why: str) -> None:
        sent = holds.set([scope], why, HELD_BY)
        self.say(f"{_name(scope)}: held: {why}")
        for one in sent:
            self.say(f"LOOK: the launch of {one} was sent before: it may take off")

    # --- words ---------------------------------------------------------------------------------

    def _say_field(self, now_s: float) -> None:
        out = frozenset(self.wind.left_out(now_s))
        if out == self._out and now_s - self._said_s < SAY_S:
            return
        changed = out != self._out
        words = field_words(self.wind, now_s) if changed or self.wind.is_known(now_s) else ""
        if words or changed:
            self._said_s, self._out = now_s, out
            self.say(words or "wind: nobody who is believed tells it")

    def _tell(
        self, front: FrontAhead, rows: Iterable[AssignmentRow], status: FleetStatus, now_s: float
    ) -> None:
        """Say it, and who of those in the air is in its way and what becomes of him."""
        felt = {one.member for one in front.felt}
        seen = [(name, self._here(name, status)) for name in sorted(status.vehicles)]
        places = [("the depot", (0.0, 0.0))]
        places += [(name, at) for name, at in seen if at is not None and name not in felt]
        self.say(front_words(front, now_s, places))
        behind = _behind(front)
        for row in rows:
            if row.state is not AssignmentState.FLYING:
                continue
            if would_catch(front, self._launch(row, status), now_s):
                self._judge(row, status, behind)

    def _judge(self, row: AssignmentRow, status: FleetStatus, behind: Forecast) -> None:
        state = status.of(row.vehicle).state
        reach = self._reach_of(row.vehicle)
        here = None if state is None else self._ned(state)
        if state is None or reach is None or here is None or state.energy_left_wh is None:
            self.say(f"LOOK: {row.vehicle}: in the front's way; nobody knows its energy or place")
            return
        order = self._orders.get(row.order_id)
        laden = order is not None and not state.delivered
        flight = FlightNow(
            here=here,
            home=self._home(row),
            customer=self._ground(place_of(order)) if laden and order is not None else None,
            payload_kg=order.mass_kg if laden and order is not None else 0.0,
            left_wh=state.energy_left_wh,
        )
        found = judged(reach, flight, behind)
        if found.words:
            self.say(f"LOOK: {row.vehicle}: in the front's way: {found.words}")
        else:
            self.say(f"{row.vehicle}: in the front's way: {found.on_wh:.0f} Wh to spare behind it")

    # --- places --------------------------------------------------------------------------------

    def _launch(self, row: AssignmentRow, status: FleetStatus) -> Launch:
        """The flight of an assignment, from where its drone is."""
        here = self._here(row.vehicle, status) or (0.0, 0.0)
        order, home = self._orders.get(row.order_id), self._home(row)
        places: Places = (here, (home[0], home[1]))
        if order is not None:
            customer = self._ground(place_of(order))
            places = (here, (customer[0], customer[1]), (home[0], home[1]))
        drone = self.data.day.drone(row.vehicle)
        airframe = None if drone is None else self.data.airframes.get(drone.airframe)
        speed_mps = 10.0 if airframe is None else airframe.speeds.cruise_airspeed_mps
        return Launch(row.vehicle, places, longest_s(places, speed_mps))

    def _here(self, vehicle: str, status: FleetStatus) -> tuple[float, float] | None:
        state = status.of(vehicle).state
        if state is None or state.lat_deg is None or state.lon_deg is None:
            return None
        return self.wind.place_ne_m(state.lat_deg, state.lon_deg)

    def _ned(self, state: State) -> Ned | None:
        if state.lat_deg is None or state.lon_deg is None:
            return None
        north, east = self.wind.place_ne_m(state.lat_deg, state.lon_deg)
        return north, east, -(state.height_rel_m or 0.0)

    def _ground(self, place: Place) -> Ned:
        return place_ned(frame_at(self.data.day.depot.place), place)

    def _home(self, row: AssignmentRow) -> Ned:
        """Where it lands: its promised pad, or the depot."""
        sortie = self._sorties.get(row.id)
        if sortie is None or sortie.promised not in sortie.pads:
            return (0.0, 0.0, 0.0)
        return self._ground(sortie.pads[sortie.promised])

    def _reach_of(self, vehicle: str) -> Reach | None:
        day, drone = self.data.day, self.data.day.drone(vehicle)
        if drone is None:
            return None
        if vehicle not in self._reach:
            airframe = self.data.airframes[drone.airframe]
            energy = day_energy(day, airframe)
            self._reach[vehicle] = Reach(drone, airframe, day.mission, day.forecast, energy)
        return self._reach[vehicle]


def _behind(front: FrontAhead) -> Forecast:
    """The wind behind a front, as those told it who have felt it."""
    north, east = (sum(one.wind_ne_mps[k] for one in front.felt) / len(front.felt) for k in (0, 1))
    from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
    speed_mps = min(math.hypot(north, east), 40.0)
    return Forecast(speed_mps=speed_mps, from_deg=from_deg, std_mps=BEHIND_STD_MPS)


def _name(scope: str) -> str:
    return "every drone" if scope == ALL else scope
