"""Tracks a day with a truck: members' states and the store's rows become a `DaySnapshot`."""

import math
from dataclasses import dataclass, field, replace

from companion.core.pilot.transitions import Phase
from companion.fleet.messages import State
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.active_plan import ActivePlan
from ground_station.app.desk.forecast_watch import ForecastWatch, plan_closes
from ground_station.core.dispatch.day_snapshot import DaySnapshot, DroneStatus, TruckStatus
from ground_station.core.dispatch.dispatch_rules import distance_m
from ground_station.core.dispatch.measured_wind import DAY_AHEAD_S, forecast_now, off_sigmas
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import STANDBY, FleetStatus, VehicleStatus
from ground_station.core.fleet.truck_state import DRIVING, TRUCK
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.holds import Hold, holding
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, OrderRow, OrderState
from ground_station.core.schema.sortie_rows import SortieRow, Visit
from ground_station.core.site_wind.site_wind import SiteWind

OFF_PAD_M = 30.0
OFF_GROUND_M = 2.0

CLOSES_S = 60.0
"""The plan ahead is held against the forecast so often."""

ROWS_S = 5.0
"""Rows of the store are read again after this time, also where nothing has come."""


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of the store, read at `read_s`."""

    read_s: float
    open: frozenset[str]
    sorties: tuple[SortieRow, ...]
    serves: tuple[AssignmentRow, ...]
    told: str | None
    visits: dict[str, Visit]
    plan_made_us: int
    holds: tuple[Hold, ...]


@dataclass(slots=True)
class DayTracker:
    """Keeps what only members report: energies, who has taken off, who waits since when. `wind`:
    what they tell of the wind. `forecast`: watches over one that is followed.
    """

    store: Store
    day: DayStore
    active: ActivePlan
    clock: Clock
    wind: SiteWind | None = None
    forecast: ForecastWatch | None = None
    snapshot: DaySnapshot | None = None
    _energy_wh: dict[str, tuple[float, float]] = field(default_factory=dict)
    _off_ground: set[str] = field(default_factory=set)
    _truck_stop: tuple[str, bool] | None = None
    _waits_s: dict[str, float] = field(default_factory=dict)
    _began_us: int | None = None
    _rows: _Rows | None = None
    _from_us: int = 0
    _plan_made_us: int = 0
    _closing_s: float = -math.inf
    _closing: str = ""
    _closed_before: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self._from_us = self.clock.epoch_us()

    def reload(self) -> None:
        """Read the store again for the next snapshot: something has been written, or may have
        been.
        """
        self._rows = None

    def reload_old(self) -> None:
        """Read it again now and then in any case: others write to it too."""
        rows = self._rows
        if rows is not None and self.clock.monotonic_s() - rows.read_s > ROWS_S:
            self._rows = None

    def on_state(self, state: State) -> None:
        """Take a state that a member has published."""
        if state.vehicle == TRUCK:
            self._on_truck_state(state)
            return
        if state.armed and state.assignment:
            if state.energy_left_wh is not None:
                first = self._energy_wh.get(state.assignment, (state.energy_left_wh, 0.0))[0]
                self._energy_wh[state.assignment] = (first, state.energy_left_wh)
            if (state.height_rel_m or 0.0) > OFF_GROUND_M:
                self._off_ground.add(state.assignment)

    def _on_truck_state(self, state: State) -> None:
        """Note its arrivals and departures in the store."""
        if state.stop is None:
            return
        now = (state.stop, state.phase == DRIVING)
        if now != self._truck_stop:
            self.day.truck_is(None if now[1] else state.stop)
            self._rows = None
            self._truck_stop = now

    def observe(self, status: FleetStatus) -> DaySnapshot:
        """The snapshot of this moment."""
        now_s = self.clock.monotonic_s()
        truck = status.vehicles.get(TRUCK)
        began_us = self._begun_us(truck is not None and truck.present(now_s))
        rows = self._rows = self._rows or self._read(now_s)
        drones = {
            d.id: self._drone_status(status.of(d.id), status.charge_frac_at_rest(d.id), now_s)
            for d in self.active.data.day.drones
        }
        self.snapshot = DaySnapshot(
            now_s=max(0.0, (self.clock.epoch_us() - began_us) / 1e6),
            began_us=began_us,
            plan=self.active.plan,
            truck=_truck_status(truck, rows.told, now_s),
            drones=drones,
            open=rows.open,
            sorties=rows.sorties,
            serves=rows.serves,
            visits=rows.visits,
            replanning=self.active.is_replanning,
            plan_made_s=max(0.0, (rows.plan_made_us - began_us) / 1e6),
            tried_s=self.active.attempt.at_s,
            tried=self.active.attempt.situation,
            waited_s=self._waited(rows.sorties, drones, now_s),
            wind_off_sigmas=off_sigmas(self.wind, now_s, self.active.data.day.forecast),
            desk_from_s=(self._from_us - began_us) / 1e6,
            held=frozenset(vehicle for vehicle in drones if holding(rows.holds, vehicle)),
        )
        if self.forecast is not None:
            closed = self.forecast.given_back(rows.holds)
            closing = self._closes(self.snapshot, self.forecast, now_s)
            self.snapshot = replace(self.snapshot, closed=closed, closing=closing)
        return self.snapshot

    def _closes(self, day: DaySnapshot, forecast: ForecastWatch, now_s: float) -> str:
        """What the forecast closes of the plan ahead: what two looks in a row find."""
        if now_s - self._closing_s < CLOSES_S:
            return self._closing
        self._closing_s = now_s
        late_s = max(0.0, day.delay_s(), day.held_s())
        pending = [(s, now_s + max(0.0, s.launch_s + late_s - day.now_s)) for s in day.pending()]
        orders = {order.id: order for order in self.active.data.orders}
        found = plan_closes(forecast, pending, self.active.stops, orders)
        both = sorted(found.keys() & self._closed_before)
        self._closed_before = frozenset(found)
        self._closing = f"the forecast closes {', '.join(both)}" if both else ""
        return self._closing

    def _begun_us(self, truck_here: bool) -> int:
        """The day begins when its truck is first heard."""
        if self._began_us is None:
            self._began_us = self.day.begin() if truck_here else self.day.began_us()
        return self.clock.epoch_us() if self._began_us is None else self._began_us

    def _read(self, now_s: float) -> _Rows:
        orders = self.store.orders()
        self.active.note_orders(orders)
        plan_made_us = self._read_plan()
        return _Rows(
            read_s=now_s,
            open=_open(orders),
            sorties=tuple(self.day.sorties()),
            serves=tuple(r for r in self.store.assignments() if r.vehicle == TRUCK),
            told=self.day.told(),
            visits={visit.stop: visit for visit in self.day.visits()},
            plan_made_us=plan_made_us,
            holds=tuple(self.store.holds()),
        )

    def _read_plan(self) -> int:
        """When the newest plan was taken; it is read where it is not the one that was known."""
        made_us = self.day.plan_made_us()
        if made_us != self._plan_made_us:
            self.active.note_plan(self.day.plan())
            self._plan_made_us = made_us
        return made_us

    def _waited(
        self, sorties: tuple[SortieRow, ...], drones: dict[str, DroneStatus], now_s: float
    ) -> dict[str, float]:
        """By assignment: how long a drone on its pad has not been ready, since this desk began."""
        waiting = (AssignmentState.ORDERED, AssignmentState.ABOARD)
        on_pads = [r for r in sorties if r.placed and r.row.state in waiting]
        late = [r.id for r in on_pads if r.vehicle in drones and not drones[r.vehicle].ready]
        self._waits_s = {id_: self._waits_s.get(id_, now_s) for id_ in late}
        return {id_: now_s - since_s for id_, since_s in self._waits_s.items()}

    def _drone_status(
        self, seen: VehicleStatus, charge_frac: float | None, now_s: float
    ) -> DroneStatus:
        state = seen.state
        if state is None:
            return DroneStatus(seen.vehicle)
        return DroneStatus(
            vehicle=seen.vehicle,
            present=seen.present(now_s),
            doubtful=bool(seen.doubts),
            idle=state.phase == STANDBY and not state.armed,
            ready=state.phase == Phase.READY.value and not state.armed,
            off_ground=state.assignment in self._off_ground or self._left_pad(state),
            assignment=state.assignment,
            home=state.home,
            lat_deg=state.lat_deg,
            lon_deg=state.lon_deg,
            charge_frac=charge_frac,
            silent_s=seen.silent_s(now_s),
        )

    def _left_pad(self, state: State) -> bool:
        """Whether it is away from its launch pad: known also after a restart of the desk."""
        rows = self.snapshot.sorties if self.snapshot is not None else ()
        row = next((row for row in rows if row.id == state.assignment), None)
        if row is None:
            return False
        away_m = distance_m(state.lat_deg, state.lon_deg, row.pads[row.sortie.launch])
        return away_m is not None and away_m > OFF_PAD_M

    def still_open(self) -> frozenset[str]:
        """Orders without an assignment, by the store."""
        return _open(self.store.orders(OrderState.OPEN))

    def forecast_now(self, before: Forecast) -> Forecast:
        """The forecast by what drones in flight tell; where they are too few the one that is
        followed, or `before`.
        """
        if self.forecast is not None:
            before = self.forecast.expected(DAY_AHEAD_S)
        return forecast_now(self.wind, self.clock.monotonic_s(), before)

    @property
    def day_forecast(self) -> DayForecast | None:
        """The forecast that is followed, in the day's time."""
        if self.forecast is None or self.snapshot is None:
            return None
        return self.forecast.follows.of_day(self.snapshot.began_us)

    def energy_used_wh(self, assignment: str) -> float | None:
        """Energy used by a flight that is over, once; None: it has reported none."""
        told = self._energy_wh.pop(assignment, None)
        return None if told is None else max(0.0, told[0] - told[1])


def _open(orders: list[OrderRow]) -> frozenset[str]:
    return frozenset(row.order.id for row in orders if row.state is OrderState.OPEN)


def _truck_status(seen: VehicleStatus | None, told: str | None, now_s: float) -> TruckStatus | None:
    state = seen.state if seen is not None else None
    if seen is None or state is None or state.stop is None:
        return None
    stop = told or state.stop
    return TruckStatus(seen.present(now_s), state.phase == DRIVING or stop != state.stop, stop)
