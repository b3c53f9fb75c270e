"""The map's picture of one moment, present or past."""

from collections.abc import Iterator
from typing import Any

import msgspec

from companion.core.base.import_report import report_lines
from companion.fleet.messages import State
from ground_station.app.map.attention_facts import fleet_facts
from ground_station.app.map.day_pictured import truck_shown
from ground_station.app.map.drone_view import DroneSnapshot, drone_shown
from ground_station.app.map.fleet_receiver import VehicleTrack
from ground_station.app.map.map_snapshot import MapSnapshot, StoreSnapshot
from ground_station.app.map.picture import (
    AttentionShown,
    DroneShown,
    MapPicture,
    Point,
    SiteShown,
    WindShown,
    to_json_types,
)
from ground_station.app.map.reach_ring import ReachableAreas
from ground_station.app.map.site_shown import forecast_shown, site_shown
from ground_station.app.views.day_content import DisplayRows
from ground_station.core.fleet.attention import AttentionLimits, attention_items
from ground_station.core.fleet.risk_words import format_loss
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.holds import hold_of_vehicle_or_of_all


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
        self._limits = AttentionLimits()
        if data is not None:
            day = data.day
            self._limits = AttentionLimits(
                day.low_spare_wh, day.contact_timeout_s, day.mission.max_loss
            )

    def build_picture(self, snapshot: MapSnapshot) -> dict[str, Any]:
        """Return the picture as JSON types."""
        drones = {
            name: self._drone_shown(snapshot, name)
            for name in self._displayed_drone_names(snapshot)
        }
        day, truck = snapshot.store.rows.day, None
        if day is not None or TRUCK in snapshot.status.vehicles:
            track = snapshot.tracks.get(TRUCK)
            received_us = None if track is None else track.received_us
            truck = truck_shown(snapshot.status.status_of(TRUCK), day, received_us)
        shown = MapPicture(
            fleet=self._fleet,
            alerts=self._attention_shown(snapshot, drones),
            notes=[
                *self._notes,
                *snapshot.notes,
                *_hold_and_confirmation_notes(snapshot.store.rows),
            ],
            handover=snapshot.store.rows.handover,
            drones=drones,
            truck=truck,
            winds=list(self._displayed_winds(snapshot)),
            desk_received_us=snapshot.desk_received_us,
            max_loss=self._limits.max_loss,
            risk_limit="" if self._limits.max_loss is None else format_loss(self._limits.max_loss),
            low_spare_wh=self._limits.low_spare_wh,
            contact_timeout_s=self._limits.contact_timeout_s,
            holds=[hold.scope for hold in snapshot.store.rows.hold_list],
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

    def _drone_shown(self, snapshot: MapSnapshot, name: str) -> DroneShown:
        rows = snapshot.store.rows
        shown = drone_shown(self._drone_snapshot(snapshot, name), snapshot.t_s)
        hold = hold_of_vehicle_or_of_all(rows.hold_list, name)
        return msgspec.structs.replace(
            shown,
            hold="" if hold is None else hold.text,
            in_place_of=rows.spares.get(name, ""),
            pack=rows.packs.get(name, ""),
        )

    def _drone_snapshot(self, snapshot: MapSnapshot, name: str) -> DroneSnapshot:
        store_snapshot = snapshot.store
        row = store_snapshot.assignments.get(name)
        vehicle_status = snapshot.status.status_of(name)
        of_day = store_snapshot.rows.spares.get(name, name)
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
            figures=None if self._area_model is None else self._area_model.drone_figures(of_day),
            epoch_us=snapshot.epoch_us,
        )

    def _displayed_winds(self, snapshot: MapSnapshot) -> Iterator[WindShown]:
        if snapshot.store.wind is not None:
            yield forecast_shown(snapshot.store.wind, "measured; the plan in force rests on it")
        elif self._data is not None:
            yield forecast_shown(self._data.day.forecast, "forecast of the day")
        if snapshot.wind_field is not None:
            yield snapshot.wind_field

    def _attention_shown(
        self, snapshot: MapSnapshot, drones: dict[str, DroneShown]
    ) -> list[AttentionShown]:
        since_us = snapshot.attention_since_us
        facts = fleet_facts(snapshot, drones, self._site)
        return [
            AttentionShown(
                key=item.key,
                level=item.level.label,
                subject=item.subject,
                title=item.title,
                text=item.text,
                actions=list(item.actions),
                times_us=dict(item.times_us),
                since_us=None if since_us is None else since_us.get(item.key, snapshot.epoch_us),
            )
            for item in attention_items(facts, self._limits, since_us or {})
        ]


def _hold_and_confirmation_notes(rows: DisplayRows) -> Iterator[str]:
    for hold in rows.hold_list:
        yield hold.text
    for row in rows.assignments:
        if row.confirmed_by is not None:
            yield f"{row.vehicle}: launch of {row.order_id} confirmed by {row.confirmed_by}"
