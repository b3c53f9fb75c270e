"""Dispatch from the depot, without a truck: the nearest order that a free drone can bring."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.fleet.messages import State
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.dispatcher import Progress
from ground_station.app.desk.forecast_watch import ForecastWatch
from ground_station.app.desk.launch_pacing import LaunchPacing
from ground_station.core.dispatch.depot_assignment import DepotAssigner, FreeDrone
from ground_station.core.dispatch.flight_tables import (
    NeighbourKeys,
    no_keys,
    with_neighbour_keys,
)
from ground_station.core.dispatch.measured_wind import NEXT_AHEAD_S, differs, next_flights
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.holds import holding
from ground_station.core.schema.orders import AssignmentRow, OrderState, Service
from ground_station.core.site_wind.site_wind import SiteWind

WIND_S = 30.0
"""The wind that orders are weighed in is looked at so often: each change prices all anew."""

LAUNCHES = 3
"""An assignment whose launch is refused so often is withdrawn: a person has to look at it."""


@dataclass(frozen=True, slots=True)
class DepotParams:
    """How the depot is run. `assigns` and `launches` False: orders and launches are a person's.

    `launch_gap_s`: least time from a take-off to the next launch, by whichever desk. `confirms`:
    each launch waits for a named person.
    """

    by: str = "desk"
    assigns: bool = True
    launches: bool = True
    launch_gap_s: float = 20.0
    confirms: bool = False


@dataclass(slots=True)
class DepotDispatcher:
    """`Dispatcher` for drones that start from the depot and come home to it.

    `wind`: what the fleet tells of it; None: the day's forecast stays. `forecast`: watches over one
    that is followed. `impossible`: orders that no drone of the day can bring; they do not keep the
    day open.
    """

    store: Store
    data: DayData
    assigner: DepotAssigner
    clock: Clock
    say: Callable[[str], None]
    params: DepotParams = field(default_factory=DepotParams)
    impossible: frozenset[str] = frozenset()
    wind: SiteWind | None = None
    forecast: ForecastWatch | None = None
    neighbour_keys: NeighbourKeys = no_keys
    _planned: Forecast | None = None
    _planned_s: float = -math.inf
    _pacing: LaunchPacing = field(init=False)
    _asked: set[str] = field(default_factory=set)
    _is_full: bool = False

    def __post_init__(self) -> None:
        gap_s = self.params.launch_gap_s
        self._pacing = LaunchPacing(self.store, self.clock, self.say, gap_s)

    def begin(self) -> None:
        """A launch just before a restart keeps its gap to the next one."""
        self._pacing.begin()

    def on_state(self, state: State) -> None:
        """Count a take-off; for the rest, `turn` reads the fleet's status."""
        self._pacing.on_state(state)

    def on_ready(self, assignment: AssignmentRow) -> None:
        """Launch it when its slot has come; withdraw it after too many refusals."""
        id_, vehicle, params = assignment.id, assignment.vehicle, self.params
        if self.store.refused_launches(id_) >= LAUNCHES:
            if self.store.withdraw(id_, params.by):
                self.say(f"{vehicle}: launch refused {LAUNCHES} times: {id_} withdrawn")
            return
        if not params.launches:
            return
        if params.confirms and assignment.confirmed_by is None:
            self._ask_for_a_person(assignment)
            return
        self._asked.discard(id_)  # a hold makes that word void: it is asked for again
        if not self._pacing.may_launch():
            return
        after = self._pacing.newest_launch
        if self.store.launch(id_, params.by, after=after, confirmed=params.confirms):
            word = f", confirmed by {assignment.confirmed_by}" if params.confirms else ""
            self.say(f"{vehicle}: launch of {id_} ordered{word}")

    def _ask_for_a_person(self, assignment: AssignmentRow) -> None:
        """Say, once for each launch, what lets it go."""
        if assignment.id not in self._asked:
            self._asked.add(assignment.id)
            order = assignment.order_id
            self.say(
                f"{assignment.vehicle}: ready: `ground-station order launch {order}` lets it go"
            )

    def turn(self, status: FleetStatus, *, changed: bool) -> Progress:
        """Give open orders to free drones."""
        del changed
        self._pacing.update(status)
        given_back = self._give_back()
        if not self.params.assigns:
            return Progress.CHANGED if given_back else Progress.NONE
        free = self._free_drones(status)
        if free:
            self._note_wind()
        done = bool(free) and self._assign(free)
        if done or given_back:
            return Progress.CHANGED
        waits = self.forecast is not None and self.forecast.opens_again()
        return Progress.UNDER_WAY if waits else Progress.NONE

    def _give_back(self) -> bool:
        """Take back assignments whose launch the forecast has closed for good."""
        if self.forecast is None:
            return False
        done = False
        for id_, why in self.forecast.given_back(self.store.holds()).items():
            if self.params.launches and self.store.withdraw(id_, self.params.by):
                self.say(f"{id_}: given back: {why}")
                done = True
        return done

    def _note_wind(self) -> None:
        """Price orders in the wind that the fleet tells, where it has moved."""
        now_s, before = self.clock.monotonic_s(), self._planned or self.data.day.forecast
        if now_s - self._planned_s < WIND_S:
            return
        self._planned_s = now_s
        expected = self.data.day.forecast
        if self.forecast is not None:
            expected = self.forecast.expected(NEXT_AHEAD_S)
        wind = next_flights(self.wind, now_s, expected)
        if differs(wind, before):
            self._planned = wind
            self.assigner.plan_in(wind)
            words = f"{wind.speed_mps:.1f} +- {wind.std_mps:.1f} m/s from {wind.from_deg:.0f}"
            self.say(f"orders are weighed in wind {words}")

    def _free_drones(self, status: FleetStatus) -> list[FreeDrone]:
        """Those that stand at the depot with nothing to do; who stands elsewhere is fetched."""
        busy = {row.vehicle for row in self.store.assignments(in_force=True)}
        holds, now_s = self.store.holds(), self.clock.monotonic_s()
        found: list[FreeDrone] = []
        for seen in sorted(status.vehicles.values(), key=lambda seen: seen.vehicle):
            vehicle, state = seen.vehicle, seen.state
            if not seen.free(now_s) or vehicle in busy or holding(holds, vehicle):
                continue
            stand = state and self.assigner.stand_of(state.lat_deg, state.lon_deg)
            if stand is not None:
                charge_frac = status.charge_frac_at_rest(vehicle)
                found.append(FreeDrone(vehicle, charge_frac, stand))
        return found

    def _assign(self, free: list[FreeDrone]) -> bool:
        done, rows = False, self.store.assignments()
        self._say_full(self.assigner.is_full(rows))
        if self._is_full:  # nor need the orders be read: there may be thousands
            return False
        waiting, first = self.store.orders(OrderState.OPEN), list[str]()
        if self.forecast is not None:
            shut, first = self.forecast.shut(), self.forecast.urgent()
            waiting = [row for row in waiting if row.order.id not in shut]
        chosen = self.assigner.assign(waiting, rows, free, first)
        for choice in chosen:
            order, vehicle, layer = choice.order.id, choice.vehicle, choice.layer
            flight = self.assigner.flight_of(choice.order, vehicle, layer, choice.stand)
            flight = with_neighbour_keys(flight, self.neighbour_keys)
            no_fly, by = self.data.no_fly, self.params.by
            id_ = self.store.assign(order, vehicle, flight, no_fly, by, layer)
            if id_ is not None:
                done = True
                height_m = self.assigner.layers.mission_in(layer).cruise_height_m
                self.say(f"{vehicle}: assigned {order} ({id_}), out at {height_m:.0f} m")
        return done

    def _say_full(self, is_full: bool) -> None:
        """Say, each time that it begins, that drones wait for a layer."""
        if is_full and not self._is_full:
            self.say("every layer over the depot is taken: drones wait for one")
        self._is_full = is_full

    @property
    def is_done(self) -> bool:
        """Whether every order is settled, the truck's, or impossible for the drones."""
        assigned, opened = (self.store.orders(s) for s in (OrderState.ASSIGNED, OrderState.OPEN))
        possible = [row for row in opened if row.order.id not in self.impossible]
        return all(row.order.service is Service.TRUCK for row in (*assigned, *possible))

    @property
    def replans(self) -> None:
        """There is no plan."""
        return None

    def why_left(self, order_id: str) -> str | None:
        """What the forecast closes; else nothing is known but what the store says."""
        return None if self.forecast is None else self.forecast.why_left(order_id)

    def close(self) -> None:
        """Nothing runs beside the desk."""
