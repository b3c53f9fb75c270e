"""The map's picture of one moment, present or past."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from companion.core.base.import_report import report_lines
from companion.fleet.messages import State
from ground_station.app.map.day_pictured import orders_shown, plan_shown, truck_shown
from ground_station.app.map.drone_view import DroneSnapshot, drone_shown
from ground_station.app.map.fleet_receiver import VehicleTrack
from ground_station.app.map.flight_decisions import FlightDecisions
from ground_station.app.map.picture import (
    AlertShown,
    DroneShown,
    MapPicture,
    Point,
    SiteShown,
    TruckShown,
    WindShown,
    to_json_types,
)
from ground_station.app.map.reach_ring import ReachableAreas
from ground_station.app.map.site_shown import forecast_shown, site_shown
from ground_station.app.views.day_content import DisplayRows
from ground_station.app.views.operator_alerts import (
    CERTIFICATES_SUBJECT,
    DESK_SUBJECT,
    stuck_order_texts,
)
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, Order


@dataclass(frozen=True, slots=True)
class StoreSnapshot:
    """Store content at one moment, and the values derived from it."""

    rows: DisplayRows = field(default_factory=DisplayRows)
    wind: Forecast | None = None
    tables: dict[str, Any] = field(default_factory=dict)
    orders: dict[str, Order] = field(default_factory=dict)
    assignments: dict[str, AssignmentRow] = field(default_factory=dict)

    @classmethod
    def from_rows(cls, rows: DisplayRows, wind: Forecast | None) -> "StoreSnapshot":
        """Build the parts of the picture that depend on the store only, once per reading."""
        orders = {k: to_json_types(v) for k, v in orders_shown(rows).items()}
        tables: dict[str, Any] = {"orders": orders}
        plan = plan_shown(rows)
        if plan is not None:
            tables["plan"] = to_json_types(plan)
        return cls(
            rows=rows,
            wind=wind,
            tables=tables,
            orders={row.order.id: row.order for row in rows.orders},
            assignments={row.vehicle: row for row in rows.assignments if row.state in IN_FORCE},
        )


@dataclass(frozen=True, slots=True)
class MapSnapshot:
    """All data of one moment. `t_s`: on the clock of the statuses' receive times.

    `store_error`: error of the unreachable store; empty: reachable. `expiring_certificates`:
    certificates that expire soon. `roster_alarm`: a refused fork or rollback. `desk_alarm`: a
    silent desk. `notes`: further notes. `wind_field`: accepted wind of the site, None: unknown.
    `front_texts`: approaching fronts, as text.
    """

    t_s: float
    status: FleetStatus
    tracks: Mapping[str, VehicleTrack]
    decisions: FlightDecisions
    store: StoreSnapshot
    store_error: str = ""
    expiring_certificates: str = ""
    roster_alarm: str = ""
    desk_alarm: str = ""
    notes: tuple[str, ...] = ()
    wind_field: WindShown | None = None
    front_texts: tuple[str, ...] = ()


class MapView:
    """Builds the pictures of one map for any moment of its fleet."""

    def __init__(
        self,
        fleet: str,
        data: DayData | None = None,
        notes: tuple[str, ...] = (),
        basemap: bool = False,
        outline: bool = False,
    ) -> None:
        """`notes`: shown in every picture. Without `data` the site is unknown."""
        reports = () if data is None else data.imports
        self._fleet, self._data, self._notes = fleet, data, (*notes, *report_lines(reports))
        self._basemap, self._outline = basemap, outline and not basemap
        self._site = SiteShown() if data is None else site_shown(data)
        self._site_table = to_json_types(self._site)
        self._area_model = None if data is None else ReachableAreas(data)

    def build_picture(self, snapshot: MapSnapshot) -> dict[str, Any]:
        """Return the picture as JSON types."""
        drones = {
            name: drone_shown(self._drone_snapshot(snapshot, name), snapshot.t_s)
            for name in self._displayed_drone_names(snapshot)
        }
        day, truck = snapshot.store.rows.day, None
        if day is not None or TRUCK in snapshot.status.vehicles:
            truck = truck_shown(snapshot.status.status_of(TRUCK), day, snapshot.t_s)
        shown = MapPicture(
            fleet=self._fleet,
            alerts=list(self._day_and_vehicle_alerts(snapshot, truck, drones)),
            notes=[
                *self._notes,
                *snapshot.notes,
                *_hold_and_confirmation_notes(snapshot.store.rows),
            ],
            drones=drones,
            truck=truck,
            winds=list(self._displayed_winds(snapshot)),
            desk_alarm=snapshot.desk_alarm,
            max_loss=None if self._data is None else self._data.day.mission.max_loss,
            basemap=self._basemap,
            outline=self._outline,
        )
        return to_json_types(shown) | snapshot.store.tables | {"site": self._site_table}

    def reachable_area_boundary(
        self, state: State, store_snapshot: StoreSnapshot
    ) -> list[Point] | None:
        """Return the ring within which a drone can still land; None: unknown."""
        if self._area_model is None:
            return None
        row = store_snapshot.assignments.get(state.vehicle)
        order = None if row is None else store_snapshot.orders.get(row.order_id)
        loaded = order is not None and not state.delivered
        return self._area_model.reachable_boundary_points(
            state, order.mass_kg if order and loaded else 0.0
        )

    def _displayed_drone_names(self, snapshot: MapSnapshot) -> list[str]:
        day = snapshot.store.rows.day
        sorties = () if day is None else (row.vehicle for row in day.sorties)
        of_day = () if self._data is None else (drone.id for drone in self._data.day.drones)
        known = snapshot.status.vehicles
        names = {
            *known,
            *snapshot.store.assignments,
            *sorties,
            *(of_day if day is not None else ()),
        }
        return sorted(names - {TRUCK})

    def _drone_snapshot(self, snapshot: MapSnapshot, name: str) -> DroneSnapshot:
        store_snapshot = snapshot.store
        row = store_snapshot.assignments.get(name)
        vehicle_status = snapshot.status.status_of(name)
        return DroneSnapshot(
            status=vehicle_status,
            track=snapshot.tracks.get(name) or VehicleTrack(),
            assignment=row,
            order=None if row is None else store_snapshot.orders.get(row.order_id),
            day=store_snapshot.rows.day,
            decision=snapshot.decisions.latest_decision_on_flight(vehicle_status.state),
            diverted_to=snapshot.decisions.diversion_site_in_force(vehicle_status.state),
            depot=self._site.depot,
            rally_points=self._site.rally,
        )

    def _displayed_winds(self, snapshot: MapSnapshot) -> Iterator[WindShown]:
        if snapshot.store.wind is not None:
            yield forecast_shown(snapshot.store.wind, "measured; the plan in force rests on it")
        elif self._data is not None:
            yield forecast_shown(self._data.day.forecast, "forecast of the day")
        if snapshot.wind_field is not None:
            yield snapshot.wind_field

    def _day_and_vehicle_alerts(
        self, snapshot: MapSnapshot, truck: TruckShown | None, drones: dict[str, DroneShown]
    ) -> Iterator[AlertShown]:
        if snapshot.store_error:
            yield AlertShown(subject="store", text=f"away, rows are old: {snapshot.store_error}")
        if snapshot.desk_alarm:
            yield AlertShown(subject=DESK_SUBJECT, text=snapshot.desk_alarm)
        if snapshot.roster_alarm:
            yield AlertShown(subject="roster", text=snapshot.roster_alarm)
        if snapshot.expiring_certificates:
            yield AlertShown(subject=CERTIFICATES_SUBJECT, text=snapshot.expiring_certificates)
        yield from (AlertShown(subject="wind", text=words) for words in snapshot.front_texts)
        if not snapshot.status.vehicles:
            yield AlertShown(subject=self._fleet, text="no vehicle connected")
        members = {TRUCK: truck} | drones if truck is not None else drones
        for name, shown in members.items():
            yield from (AlertShown(subject=name, text=words) for words in shown.alarms)
        for name, reason in snapshot.store.rows.idle_reasons.items():
            yield AlertShown(subject=name, text=f"no order: {reason}")
        for order, words in stuck_order_texts(snapshot.store.rows.orders):
            yield AlertShown(subject=order, text=words)


def _hold_and_confirmation_notes(rows: DisplayRows) -> Iterator[str]:
    for hold in rows.hold_list:
        yield hold.text
    for row in rows.assignments:
        if row.confirmed_by is not None:
            yield f"{row.vehicle}: launch of {row.order_id} confirmed by {row.confirmed_by}"
