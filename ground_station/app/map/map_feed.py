"""Keeps the live map's picture: receives the fleet's states, reads the store, publishes changes.

One thread runs `listen_and_publish_due_picture`; the server's threads only read published pictures
and call `margin_history_of` and `reachable_area_boundary`, which read values that are replaced as a
whole and never modified.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.database import StoreError
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.decision_reader import DecisionReader, ReceivedDecision
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.web.live_stream import LiveStream
from ground_station.app.map.fleet_receiver import FleetListener, ReturnMarginSample
from ground_station.app.map.flight_decisions import FlightDecisions
from ground_station.app.map.map_snapshot import MapSnapshot, StoreSnapshot
from ground_station.app.map.map_view import MapView
from ground_station.app.map.picture import Point, WindShown
from ground_station.app.map.wind_shown import wind_field_shown
from ground_station.app.views.day_content import read_display_rows
from ground_station.app.views.operator_alerts import expiring_certificates_text
from ground_station.app.views.order_view import order_record
from ground_station.app.views.wind_notes import recent_front_texts
from ground_station.core.fleet.certificate_ends import CertificateExpiry
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.site_wind.site_field import ESTIMATE_INTERVAL_S

PICTURE_INTERVAL_S = 0.2
STORE_INTERVAL_S = 0.5
"""Interval of store readings: operator commands are rare, so a longer delay is not noticed."""

MAX_PICTURE_INTERVAL_S = 1.0
"""Maximum interval of pictures: an unchanged one is sent again to show that the feed is alive."""

MAX_HISTORY_SAMPLES = 2000
"""Maximum number of samples of one drone's history: more than a screen has columns."""


class MapPublisher:
    """Feed of one map."""

    def __init__(
        self,
        view: MapView,
        listener: FleetListener,
        store: Store,
        clock: Clock,
        certificates: Callable[[], CertificateExpiry | None] = lambda: None,
    ) -> None:
        self.stream = LiveStream()
        self._view, self._listener, self._store, self._clock = view, listener, store, clock
        self._day = DayStore(store.database, clock.epoch_us)
        self._decisions = DecisionReader(store.database)
        self._flights = FlightDecisions()
        self._store_snapshot, self._store_error = StoreSnapshot(), ""
        self._certificates = certificates
        self._wind_field: WindShown | None = None
        self._fronts: tuple[str, ...] = ()
        self._station_faults: tuple[str, ...] = ()
        self._attention_since_us: dict[str, int] = {}
        self._next_wind_s = 0.0
        self._next_picture_s, self._next_store_read_s, self._last_picture_s = 0.0, 0.0, 0.0

    def listen_and_publish_due_picture(self) -> None:
        """Listen until the next picture is due, and publish it if it has changed."""
        now_s = self._clock.monotonic_s()
        self._listener.receive_and_process_messages(max(self._next_picture_s - now_s, 0.0))
        now_s = self._clock.monotonic_s()
        if now_s < self._next_picture_s:
            return
        self._next_picture_s = now_s + PICTURE_INTERVAL_S
        if now_s >= self._next_store_read_s:
            self._next_store_read_s = now_s + STORE_INTERVAL_S
            self._update_store_snapshot()
        picture, before = self.build_picture(now_s), self.stream.latest_frame
        is_due = now_s - self._last_picture_s >= MAX_PICTURE_INTERVAL_S
        if is_due or before is None or before.picture != picture:
            self._last_picture_s = now_s
            self.stream.publish(picture, self._clock.epoch_us())

    # --- the store -----------------------------------------------------------------------------

    def _update_store_snapshot(self) -> None:
        with self._suppress_and_record_store_error():
            rows = read_display_rows(self._store, self._day, self._clock.epoch_us())
            wind = self._day.measured_wind_of_last_plan()
            for received in self._decisions.read_new_decisions():
                self._record_decision(received)
            released = self._flights.releases
            self._store_snapshot = StoreSnapshot.from_rows(rows, wind, released)
            self._store_error = ""

    @contextmanager
    def _suppress_and_record_store_error(self) -> Iterator[None]:
        try:
            yield
        except StoreError as error:
            self._store_error = str(error)

    def _record_decision(self, received: ReceivedDecision) -> None:
        """Record a decision; it is also a margin sample if no state of the drone is received."""
        self._flights.record_decision(received)
        track = self._listener.get_or_create_track(received.event.vehicle)
        if track.received_us is None:
            event = received.event
            track.margin_samples.append(
                ReturnMarginSample(received.received_us, event.margin_wh, event.p_home)
            )

    # --- the picture ---------------------------------------------------------------------------

    def build_picture(self, now_s: float) -> dict[str, Any]:
        """Return the picture at this time of the monotonic clock, as JSON types."""
        listener, epoch_us = self._listener, self._clock.epoch_us()
        desks = listener.status.desks
        age_s = desks.age_s(now_s)
        expiring = expiring_certificates_text(self._certificates(), epoch_us)
        self._update_wind_if_due(now_s)
        snapshot = MapSnapshot(
            now_s,
            listener.status,
            listener.tracks,
            self._flights,
            self._store_snapshot,
            self._store_error,
            expiring,
            roster_alarm=listener.status.roster_alarm,
            desk_alarm=desks.alarm_text(now_s),
            wind_field=self._wind_field,
            front_texts=self._fronts,
            station_texts=self._station_faults,
            desk_silence_s=desks.silence_s(now_s),
            desk_received_us=None if age_s is None else 1_000_000 * round(epoch_us / 1e6 - age_s),
            attention_since_us=self._attention_since_us,
            epoch_us=epoch_us,
        )
        picture = self._view.build_picture(snapshot)
        self._attention_since_us = {
            item["key"]: item["since_us"] for item in picture.get("attention", ())
        }
        return picture

    def _update_wind_if_due(self, now_s: float) -> None:
        """Update the wind at long intervals: each change causes a picture to be sent."""
        wind = self._listener.wind
        if wind is None or now_s < self._next_wind_s:
            return
        self._next_wind_s = now_s + ESTIMATE_INTERVAL_S
        self._wind_field = wind_field_shown(wind, now_s)
        faults = (
            {}
            if self._listener.stations is None
            else self._listener.stations.station_registry.reason_by_unused_station(now_s)
        )
        self._station_faults = tuple(f"{name}: {why}" for name, why in sorted(faults.items()))
        self._fronts = recent_front_texts(wind, self._listener.status, now_s)

    # --- what the page asks for ----------------------------------------------------------------

    def margin_history_of(self, vehicle: str) -> list[dict[str, Any]] | None:
        """Return a drone's margins and probabilities, oldest first; None: unknown name."""
        track = self._listener.tracks.get(vehicle)
        return (
            None
            if track is None
            else thinned_margin_history_json(list(track.margin_samples.copy()))
        )

    def order_record_of(self, order: str) -> dict[str, Any] | None:
        """Return an order with its history and proof; None: unknown, or the store is away."""
        try:
            return order_record(self._store, order)
        except LeewayError:
            return None

    def reachable_area_boundary(self, vehicle: str) -> list[Point] | None:
        """Return the ring within which a drone can still land; None: unknown."""
        vehicle_status = self._listener.status.vehicles.get(vehicle)
        if vehicle_status is None or vehicle_status.state is None:
            return None
        return self._view.reachable_area_boundary(vehicle_status.state, self._store_snapshot)


def thinned_margin_history_json(samples: list[ReturnMarginSample]) -> list[dict[str, Any]]:
    """Return margins and probabilities of a drone, thinned to the resolution of a screen."""
    return [
        _sample_fields(sample) for sample in samples[:: len(samples) // MAX_HISTORY_SAMPLES + 1]
    ]


def _sample_fields(sample: ReturnMarginSample) -> dict[str, Any]:
    fields = {"t_us": sample.received_us, "margin_wh": sample.margin_wh, "p_home": sample.p_home}
    return {key: value for key, value in fields.items() if value is not None}
