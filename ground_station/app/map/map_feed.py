"""Keeps the live map's picture: listens to the fleet, reads the store, publishes what it sees.

One thread runs `turn`; the server's threads only read what was published, and ask `history` and
`reach`, which look at values that are replaced and never changed.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ground_station.adapters.store.database import StoreError
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.decision_reader import DecisionReader, HeardDecision
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.web.live_stream import LiveStream
from ground_station.app.map.fleet_ear import FleetEar, PromiseSample
from ground_station.app.map.flight_decisions import FlightDecisions
from ground_station.app.map.map_view import MapView, Moment, StoreReading
from ground_station.app.map.picture import Point, WindShown
from ground_station.app.map.wind_shown import field_shown
from ground_station.app.views.attention import ending_certificates
from ground_station.app.views.watched_rows import read_rows
from ground_station.app.views.wind_notes import front_notes
from ground_station.core.fleet.desk_figures import CertificateFigures
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.site_wind.site_belief import SETTLE_S

TICK_S = 0.2
ROWS_S = 0.5
"""Between two readings of the store: deeds are a few a minute, and a person sees no less."""

BEAT_S = 1.0
"""A picture that has not changed is published again after so long: the page sees that we live."""

SAMPLES = 2000
"""Of one drone's history that are sent: more than a screen has columns."""


class MapFeed:
    """The feed of one map."""

    def __init__(
        self,
        view: MapView,
        ear: FleetEar,
        store: Store,
        clock: Clock,
        certificates: Callable[[], CertificateFigures | None] = lambda: None,
    ) -> None:
        self.stream = LiveStream()
        self._view, self._ear, self._store, self._clock = view, ear, store, clock
        self._day = DayStore(store.database, clock.epoch_us)
        self._decisions = DecisionReader(store.database)
        self._flights = FlightDecisions()
        self._read, self._away = StoreReading(), ""
        self._certificates = certificates
        self._field: WindShown | None = None
        self._fronts: tuple[str, ...] = ()
        self._wind_s = 0.0
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
            for heard in self._decisions.newer():
                self._note_decision(heard)
            self._read, self._away = StoreReading.of(rows, wind), ""

    @contextmanager
    def _store_may_be_away(self) -> Iterator[None]:
        try:
            yield
        except StoreError as error:
            self._away = str(error)

    def _note_decision(self, heard: HeardDecision) -> None:
        """Also a sample of the promise, where nobody has heard that drone's states yet."""
        self._flights.note(heard)
        track = self._ear.track_of(heard.event.vehicle)
        if track.heard_us is None:
            event = heard.event
            track.promises.append(PromiseSample(heard.heard_us, event.margin_wh, event.p_home))

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
        ear = self._ear
        ending = ending_certificates(self._certificates(), self._clock.epoch_us())
        self._look_at_wind(now_s)
        moment = Moment(
            now_s,
            ear.status,
            ear.tracks,
            self._flights,
            self._read,
            self._away,
            ending,
            field=self._field,
            fronts=self._fronts,
        )
        return self._view.picture(moment)

    def _look_at_wind(self, now_s: float) -> None:
        """Now and then: a person sees no less, and each look is a picture to be sent."""
        wind = self._ear.wind
        if wind is None or now_s < self._wind_s:
            return
        self._wind_s = now_s + SETTLE_S
        self._field = field_shown(wind, now_s)
        troubles = {} if self._ear.stations is None else self._ear.stations.book.troubles(now_s)
        stations = (f"station {name}: {why}" for name, why in sorted(troubles.items()))
        self._fronts = (*front_notes(wind, self._ear.status, now_s), *stations)

    # --- what the page asks for ----------------------------------------------------------------

    def history(self, vehicle: str) -> list[dict[str, Any]] | None:
        """What a drone said of its promise, oldest first; None: nobody of this name is known."""
        track = self._ear.tracks.get(vehicle)
        return None if track is None else history_of(list(track.promises.copy()))

    def reach(self, vehicle: str) -> list[Point] | None:
        """Where a drone can still land; None: not known."""
        seen = self._ear.status.vehicles.get(vehicle)
        if seen is None or seen.state is None:
            return None
        return self._view.reach(seen.state, self._read)


def history_of(samples: list[PromiseSample]) -> list[dict[str, Any]]:
    """What a drone said of its promise, thinned to what a screen shows."""
    return [_sample(sample) for sample in samples[:: len(samples) // SAMPLES + 1]]


def _sample(sample: PromiseSample) -> dict[str, Any]:
    told = {"t_us": sample.heard_us, "margin_wh": sample.margin_wh, "p_home": sample.p_home}
    return {key: value for key, value in told.items() if value is not None}
