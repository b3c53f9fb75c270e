"""The map's picture of one moment, the running or a past one."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from companion.fleet.messages import State
from ground_station.app.map.day_pictured import orders_shown, plan_shown, truck_shown
from ground_station.app.map.drones_shown import DroneFacts, drone_shown
from ground_station.app.map.fleet_ear import VehicleTrack
from ground_station.app.map.flight_decisions import Decisions
from ground_station.app.map.picture import (
    AttentionShown,
    DroneShown,
    MapPicture,
    Point,
    SiteShown,
    TruckShown,
    WindShown,
    as_table,
)
from ground_station.app.map.reach_ring import ReachRings
from ground_station.app.map.site_shown import forecast_shown, site_shown
from ground_station.app.map.wind_shown import fleet_wind
from ground_station.app.views.attention import CERTIFICATES, stuck_orders
from ground_station.app.views.watched_rows import WatchRows
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, Order


@dataclass(frozen=True, slots=True)
class StoreReading:
    """What the store held at one moment, and what follows from that alone."""

    rows: WatchRows = field(default_factory=WatchRows)
    wind: Forecast | None = None
    tables: dict[str, Any] = field(default_factory=dict)
    orders: dict[str, Order] = field(default_factory=dict)
    held: dict[str, AssignmentRow] = field(default_factory=dict)

    @classmethod
    def of(cls, rows: WatchRows, wind: Forecast | None) -> "StoreReading":
        """The parts of the picture that are the store's alone are made once for each reading."""
        orders = {k: as_table(v) for k, v in orders_shown(rows).items()}
        tables: dict[str, Any] = {"orders": orders}
        plan = plan_shown(rows)
        if plan is not None:
            tables["plan"] = as_table(plan)
        return cls(
            rows=rows,
            wind=wind,
            tables=tables,
            orders={row.order.id: row.order for row in rows.orders},
            held={row.vehicle: row for row in rows.assignments if row.state in IN_FORCE},
        )


@dataclass(frozen=True, slots=True)
class Moment:
    """All that is known at one moment. `t_s`: by the clock that the statuses were heard by.

    `away`: why the store cannot be read; empty: it can. `ending`: whose certificates end soon.
    `notes`: what else is to be said. `field`: the wind that is believed of the site, None: not
    known. `fronts`: that come, in words.
    """

    t_s: float
    status: FleetStatus
    tracks: Mapping[str, VehicleTrack]
    decisions: Decisions
    read: StoreReading
    away: str = ""
    ending: str = ""
    notes: tuple[str, ...] = ()
    field: WindShown | None = None
    fronts: tuple[str, ...] = ()


class MapView:
    """What one map shows of any moment of its fleet."""

    def __init__(
        self,
        fleet: str,
        data: DayData | None = None,
        notes: tuple[str, ...] = (),
        basemap: bool = False,
        outline: bool = False,
    ) -> None:
        """`notes`: what is always to be said. Without `data` nothing of the place is known."""
        self._fleet, self._data, self._notes = fleet, data, notes
        self._basemap, self._outline = basemap, outline and not basemap
        self._site = SiteShown() if data is None else site_shown(data)
        self._site_table = as_table(self._site)
        self._rings = None if data is None else ReachRings(data)

    def picture(self, moment: Moment) -> dict[str, Any]:
        """What is seen, as JSON's own types."""
        drones = {
            name: drone_shown(self._facts(moment, name), moment.t_s)
            for name in self._drones(moment)
        }
        truck = _truck(moment)
        shown = MapPicture(
            fleet=self._fleet,
            attention=list(self._attention(moment, truck, drones)),
            notes=[*self._notes, *moment.notes, *_store_notes(moment.read.rows)],
            drones=drones,
            truck=truck,
            winds=list(self._winds(moment)),
            max_loss=None if self._data is None else self._data.day.mission.max_loss,
            basemap=self._basemap,
            outline=self._outline,
        )
        return as_table(shown) | moment.read.tables | {"site": self._site_table}

    def reach(self, state: State, read: StoreReading) -> list[Point] | None:
        """Where a drone can still land; None: not known."""
        if self._rings is None:
            return None
        row = read.held.get(state.vehicle)
        order = None if row is None else read.orders.get(row.order_id)
        loaded = order is not None and not state.delivered
        return self._rings.ring(state, order.mass_kg if order and loaded else 0.0)

    def _drones(self, moment: Moment) -> list[str]:
        day = moment.read.rows.day
        sorties = () if day is None else (row.vehicle for row in day.sorties)
        of_day = () if self._data is None else (drone.id for drone in self._data.day.drones)
        known = moment.status.vehicles
        names = {*known, *moment.read.held, *sorties, *(of_day if day is not None else ())}
        return sorted(names - {TRUCK})

    def _facts(self, moment: Moment, name: str) -> DroneFacts:
        read, row, seen = moment.read, moment.read.held.get(name), moment.status.of(name)
        return DroneFacts(
            seen=seen,
            track=moment.tracks.get(name) or VehicleTrack(),
            row=row,
            order=None if row is None else read.orders.get(row.order_id),
            day=read.rows.day,
            decision=moment.decisions.last(seen.state),
            diverted_to=moment.decisions.diverted_to(seen.state),
            depot=self._site.depot,
            places=self._site.rally,
        )

    def _winds(self, moment: Moment) -> Iterator[WindShown]:
        if moment.read.wind is not None:
            yield forecast_shown(moment.read.wind, "measured; the plan in force rests on it")
        elif self._data is not None:
            yield forecast_shown(self._data.day.forecast, "forecast of the day")
        if moment.field is not None:
            yield moment.field
            return
        seen = moment.status.vehicles.values()
        found = fleet_wind((s.state for s in seen if s.state is not None), moment.tracks)
        if found is not None:
            yield found

    def _attention(
        self, moment: Moment, truck: TruckShown | None, drones: dict[str, DroneShown]
    ) -> Iterator[AttentionShown]:
        if moment.away:
            yield AttentionShown(who="store", words=f"away, rows are old: {moment.away}")
        if moment.ending:
            yield AttentionShown(who=CERTIFICATES, words=moment.ending)
        yield from (AttentionShown(who="wind", words=words) for words in moment.fronts)
        if not moment.status.vehicles:
            yield AttentionShown(who=self._fleet, words="nobody is heard")
        members = {TRUCK: truck} | drones if truck is not None else drones
        for name, shown in members.items():
            yield from (AttentionShown(who=name, words=words) for words in shown.alarms)
        for order, words in stuck_orders(moment.read.rows.orders):
            yield AttentionShown(who=order, words=words)


def _truck(moment: Moment) -> TruckShown | None:
    day = moment.read.rows.day
    if day is None and TRUCK not in moment.status.vehicles:
        return None
    return truck_shown(moment.status.of(TRUCK), day, moment.t_s)


def _store_notes(rows: WatchRows) -> Iterator[str]:
    for hold in rows.holds:
        yield hold.words
    for row in rows.assignments:
        if row.confirmed_by is not None:
            yield f"{row.vehicle}: launch of {row.order_id} confirmed by {row.confirmed_by}"
