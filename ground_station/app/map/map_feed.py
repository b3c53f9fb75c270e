"""Keeps the map's picture: listens to the fleet, reads the store, publishes what it sees.

One thread runs `turn`; the server's threads only read what was published, and ask `history` and
`reach`, which look at values that are replaced and never changed.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from ground_station.adapters.store.database import StoreError
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.decision_reader import DecisionReader, HeardDecision
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.web.live_stream import LiveStream
from ground_station.app.map.day_pictured import orders_shown, plan_shown, truck_shown
from ground_station.app.map.drones_shown import DroneFacts, drone_shown
from ground_station.app.map.fleet_ear import FleetEar, PromiseSample
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
from ground_station.app.views.attention import stuck_orders
from ground_station.app.views.watched_rows import WatchRows, read_rows
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, Order

TICK_S = 0.2
ROWS_S = 0.5
"""Between two readings of the store: deeds are a few a minute, and a person sees no less."""

BEAT_S = 1.0
"""A picture that has not changed is published again after so long: the page sees that we live."""

SAMPLES = 2000
"""Of one drone's history that are sent: more than a screen has columns."""


@dataclass(frozen=True, slots=True)
class _Read:
    """What was read of the store, and what follows from that alone."""

    rows: WatchRows = field(default_factory=WatchRows)
    wind: Forecast | None = None
    tables: dict[str, Any] = field(default_factory=dict)
    orders: dict[str, Order] = field(default_factory=dict)
    held: dict[str, AssignmentRow] = field(default_factory=dict)


class MapFeed:
    """The feed of one map."""

    def __init__(
        self,
        fleet: str,
        ear: FleetEar,
        store: Store,
        clock: Clock,
        data: DayData | None = None,
        notes: tuple[str, ...] = (),
        basemap: bool = False,
    ) -> None:
        """`notes`: what is always to be said. Without `data` nothing of the place is known."""
        self.stream = LiveStream()
        self._fleet, self._ear, self._store, self._clock = fleet, ear, store, clock
        self._day = DayStore(store.database, clock.epoch_us)
        self._decisions = DecisionReader(store.database)
        self._data, self._notes, self._basemap = data, notes, basemap
        self._site = SiteShown() if data is None else site_shown(data)
        self._rings = None if data is None else ReachRings(data)
        self._read, self._away = _Read(), ""
        self._last: dict[str, HeardDecision] = {}
        self._next_s, self._rows_s, self._published_s = 0.0, 0.0, 0.0

    def turn(self) -> None:
        """Listen until the next picture is due, and publish it if it is another one."""
        now_s = self._clock.monotonic_s()
        self._ear.listen(max(self._next_s - now_s, 0.0))
        now_s = self._clock.monotonic_s()
        if now_s < self._next_s:
            return
        self._next_s = now_s + TICK_S
        if now_s >= self._rows_s:
            self._rows_s = now_s + ROWS_S
            self._read_store()
        self._publish(now_s)

    # --- the store -----------------------------------------------------------------------------

    def _read_store(self) -> None:
        with self._store_may_be_away():
            rows = read_rows(self._store, self._day, self._clock.epoch_us())
            wind = self._day.wind()
            self._note_decisions(self._decisions.newer())
            self._read, self._away = _read_of(rows, wind), ""

    @contextmanager
    def _store_may_be_away(self) -> Iterator[None]:
        try:
            yield
        except StoreError as error:
            self._away = str(error)

    def _note_decisions(self, decisions: list[HeardDecision]) -> None:
        """Also a sample of the promise, where nobody has heard that drone's states yet."""
        for heard in decisions:
            event = heard.event
            self._last[event.vehicle] = heard
            track = self._ear.track_of(event.vehicle)
            if track.heard_us is None:
                sample = PromiseSample(heard.heard_us, event.margin_wh, event.p_home)
                track.promises.append(sample)

    # --- the picture ---------------------------------------------------------------------------

    def _publish(self, now_s: float) -> None:
        picture = self.picture(now_s)
        before = self.stream.frame
        beat = now_s - self._published_s >= BEAT_S
        if beat or before is None or before.picture != picture:
            self._published_s = now_s
            self.stream.publish(picture, self._clock.epoch_us())

    def picture(self, now_s: float) -> dict[str, Any]:
        """What is seen at this time of the monotonic clock, as JSON's own types."""
        drones = {name: drone_shown(self._facts(name), now_s) for name in self._drones()}
        truck = self._truck(now_s)
        shown = MapPicture(
            fleet=self._fleet,
            attention=list(self._attention(truck, drones)),
            notes=[*self._notes, *self._store_notes()],
            drones=drones,
            truck=truck,
            winds=list(self._winds()),
            max_loss=None if self._data is None else self._data.day.mission.max_loss,
            basemap=self._basemap,
        )
        return as_table(shown) | self._read.tables | {"site": as_table(self._site)}

    def _drones(self) -> list[str]:
        day = self._read.rows.day
        sorties = () if day is None else (row.vehicle for row in day.sorties)
        of_day = () if self._data is None else (drone.id for drone in self._data.day.drones)
        known = self._ear.status.vehicles
        names = {*known, *self._read.held, *sorties, *(of_day if day is not None else ())}
        return sorted(names - {TRUCK})

    def _facts(self, name: str) -> DroneFacts:
        read, row = self._read, self._read.held.get(name)
        return DroneFacts(
            seen=self._ear.status.of(name),
            track=self._ear.track_of(name),
            row=row,
            order=None if row is None else read.orders.get(row.order_id),
            day=read.rows.day,
            decision=self._last.get(name),
            depot=self._site.depot,
            places=self._site.rally,
        )

    def _truck(self, now_s: float) -> TruckShown | None:
        day = self._read.rows.day
        if day is None and TRUCK not in self._ear.status.vehicles:
            return None
        return truck_shown(self._ear.status.of(TRUCK), day, now_s)

    def _winds(self) -> Iterator[WindShown]:
        if self._read.wind is not None:
            yield forecast_shown(self._read.wind, "measured; the plan in force rests on it")
        elif self._data is not None:
            yield forecast_shown(self._data.day.forecast, "forecast of the day")
        seen = self._ear.status.vehicles.values()
        found = fleet_wind(s.state for s in seen if s.state is not None)
        if found is not None:
            yield found

    def _attention(
        self, truck: TruckShown | None, drones: dict[str, DroneShown]
    ) -> Iterator[AttentionShown]:
        if self._away:
            yield AttentionShown(who="store", words=f"away, rows are old: {self._away}")
        if not self._ear.status.vehicles:
            yield AttentionShown(who=self._fleet, words="nobody is heard")
        members = {TRUCK: truck} | drones if truck is not None else drones
        for name, shown in members.items():
            yield from (AttentionShown(who=name, words=words) for words in shown.alarms)
        for order, words in stuck_orders(self._read.rows.orders):
            yield AttentionShown(who=order, words=words)

    def _store_notes(self) -> Iterator[str]:
        for hold in self._read.rows.holds:
            yield hold.words
        for row in self._read.rows.assignments:
            if row.confirmed_by is not None:
                yield f"{row.vehicle}: launch of {row.order_id} confirmed by {row.confirmed_by}"

    # --- what the page asks for ----------------------------------------------------------------

    def history(self, vehicle: str) -> list[dict[str, Any]] | None:
        """What a drone said of its promise, oldest first; None: nobody of this name is known."""
        track = self._ear.tracks.get(vehicle)
        if track is None:
            return None
        samples = list(track.promises.copy())  # copied in one step: the feed goes on adding
        return [_sample(sample) for sample in samples[:: len(samples) // SAMPLES + 1]]

    def reach(self, vehicle: str) -> list[Point] | None:
        """Where a drone can still land; None: not known."""
        seen = self._ear.status.vehicles.get(vehicle)
        if self._rings is None or seen is None or seen.state is None:
            return None
        row, read = self._read.held.get(vehicle), self._read
        order = None if row is None else read.orders.get(row.order_id)
        loaded = order is not None and not seen.state.delivered
        return self._rings.ring(seen.state, order.mass_kg if order and loaded else 0.0)


def _read_of(rows: WatchRows, wind: Forecast | None) -> _Read:
    """The parts of the picture that are the store's alone are made once for each reading."""
    tables: dict[str, Any] = {"orders": {k: as_table(v) for k, v in orders_shown(rows).items()}}
    plan = plan_shown(rows)
    if plan is not None:
        tables["plan"] = as_table(plan)
    return _Read(
        rows=rows,
        wind=wind,
        tables=tables,
        orders={row.order.id: row.order for row in rows.orders},
        held={row.vehicle: row for row in rows.assignments if row.state in IN_FORCE},
    )


def _sample(sample: PromiseSample) -> dict[str, Any]:
    told = {"t_us": sample.heard_us, "margin_wh": sample.margin_wh, "p_home": sample.p_home}
    return {key: value for key, value in told.items() if value is not None}
