"""A desk that follows a forecast: launches it forbids, a changed file, and measured wind."""

import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.core.wind_field.fronts import WindChange
from companion.fleet.messages import CommandStatus, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.forecast_files import ForecastRequest
from ground_station.adapters.files.watched_file import (
    READ_TIMEOUT_S,
    ForecastReader,
    create_inline_reader,
)
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.workers.beside import ProcessWorker
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.app.desk.site import forecast_watch
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.dispatch.hold_source import HoldSource
from ground_station.core.feasibility.reach import Feasible
from ground_station.core.fleet.fleet_link import LivelinessChanged, StateReceived
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.site_wind.site_wind import SiteWind
from tests.companion.wind_field.made_front import made_front
from tests.ground_station.desk_parts import HandClock, Wire
from tests.ground_station.weather.open_meteo import START_S, answer, written

DAYS = Path(__file__).parents[3] / "params" / "days"
FROM_DEG = 80.0
Winds = Callable[[int], float]


def rising(first_mps: float, per_hour_mps: float) -> Winds:
    return lambda hour: first_mps + per_hour_mps * hour


def day_of(path: Path, winds: Winds, limit_mps: float = 40.0) -> DayData:
    """Read the harbour's day with this forecast, constant over height."""
    written(path, answer(lambda hour, _: (winds(hour), FROM_DEG)))
    data = read_day(DAYS / "harbour.toml", ForecastRequest(path, START_S, keep_forecast=True))
    return replace(data, day=msgspec.structs.replace(data.day, wind_limit_mps=limit_mps))


def promised(data: DayData, order: str, speed_mps: float) -> bool:
    """Return whether the desk's filter accepts a return flight to the order in a constant wind."""
    wind = Forecast(speed_mps=speed_mps, from_deg=FROM_DEG, std_mps=2.0)
    day = msgspec.structs.replace(data.day, forecast=wind)
    the = next(one for one in data.orders if one.id == order)
    return isinstance(DepotAssigner(day, data.airframes).check_delivery(the, "d1"), Feasible)


class Depot:
    """The desk of a depot over a wire; d1 is on the ground there, d9 may fly and report wind."""

    def __init__(
        self,
        store: Store,
        data: DayData,
        forecasts: ForecastReader | None = None,
        **params: Any,
    ) -> None:
        self.store, self.data, self.clock = store, data, HandClock(1000.0, START_S - 1000.0)
        self.said: list[tuple[float, str]] = []
        self.phase, self.order = "standby", ""
        self.detections: tuple[float, float] | None = None
        self.wire = Wire()
        self.params = DepotParams(**({"assigns_orders": False, "launch_gap_s": 0.0} | params))
        say = lambda words: self.said.append((self.clock.t_s, words))  # noqa: E731
        self.desk: Desk = open_depot_desk(
            data, store, self.wire, say, self.params, clock=self.clock, forecast_reader=forecasts
        )
        self.wire.heard += [LivelinessChanged(name, name, has_joined=True) for name in ("d1", "d9")]

    def state(self, name: str) -> State:
        depot, told = self.data.day.depot, {}
        if name == "d9" and self.detections is not None:
            gust = 0.05 * ((self.clock.t_s % 7.0) - 3.0)
            told = {
                "armed": True, "height_rel_m": 40.0, "wind_cov_m2ps2": (0.3, 0.0, 0.3),
                "wind_to_n_mps": self.detections[0] + gust,
                "wind_to_e_mps": self.detections[1] + gust,
            }  # fmt: skip
        mine = {"phase": self.phase, "assignment": self.order or None} if name == "d1" else {}
        return State(**{
            "vehicle": name, "instance_id": name, "uptime_s": self.clock.t_s, "log": name,
            "last_seq": 0,
            "epoch_us": self.clock.epoch_us(), "airframe": "m100", "max_payload_kg": 1.0,
            "phase": "outbound", "lat_deg": depot.lat_deg, "lon_deg": depot.lon_deg,
            "armed": False, "height_rel_m": 0.0, "voltage_v": 26.1,
        } | mine | told)  # pyright: ignore[reportArgumentType] # fmt: skip

    def aboard(self, order: str) -> None:
        """Assign this order to d1, whose companion accepts it."""
        id_ = self.store.assign_order(order, "d1", {"format": "flight/1"}, None, "desk", 0)
        assert id_ is not None
        self.store.record_and_apply_response(f"{id_}:assign", CommandStatus.DONE, "", "d1")
        self.order = id_

    def run(self, for_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Advance in steps of five seconds; return whether `until` became true."""
        for _ in range(round(for_s / 5.0)):
            self.clock.t_s += 5.0
            self.wire.heard += [StateReceived(self.state(name)) for name in ("d1", "d9")]
            self.desk.run_cycle(0.0)
            if until():
                return True
        return False

    def holds(self) -> dict[str, str]:
        return {
            hold.scope: hold.reason
            for hold in self.store.holds_in_force()
            if hold.by in tuple(HoldSource)
        }

    def words(self) -> str:
        return "\n".join(words for _, words in self.said)


FAR, NEAR = "H-104", "H-102"
"""Two harbour orders; the wind that closes FAR is computed with the desk's filter."""


def closes_mps(data: DayData, order: str) -> float:
    """Return the lowest wind that closes the order, in steps of 0.1 m/s."""
    return next(k / 10.0 for k in range(400) if not promised(data, order, k / 10.0))


@pytest.fixture
def depot(tmp_path: Path, store: Store) -> Callable[..., Depot]:
    def made(winds: Winds, limit_mps: float = 40.0, **params: Any) -> Depot:
        data = day_of(tmp_path / "w.json", winds, limit_mps)
        store.add_orders_unless_conflict(data.orders)
        return Depot(store, data, create_inline_reader(), **params)

    return made


@pytest.fixture(scope="module")
def limit_mps(tmp_path_factory: pytest.TempPathFactory) -> float:
    """Wind speed that closes FAR."""
    return closes_mps(day_of(tmp_path_factory.mktemp("calm") / "w.json", rising(4.0, 0.0)), FAR)


@pytest.fixture
def far_ready(depot: Callable[..., Depot]) -> Callable[..., Depot]:
    """Build a depot where FAR is loaded and ready, after this duration."""

    def made(winds: Winds, for_s: float, order: str = FAR, **params: Any) -> Depot:
        site = depot(winds, **params)
        site.aboard(order)
        site.phase = "ready"
        site.run(for_s)
        return site

    return made


@pytest.mark.sample
def test_a_launch_that_the_forecast_closes_is_held_with_words_and_the_hour(far_ready, limit_mps):
    steep = far_ready(rising(limit_mps + 0.5, 0.5), 30.0)
    assert steep.wire.launches() == []
    (why,) = steep.holds().values()
    assert list(steep.holds()) == ["d1"]
    assert f"order {FAR} is not launched: at 12:00 UTC the forecast has " in why
    assert f"{limit_mps + 0.5:.0f}"[:1] in why
    assert "m/s at 40 m" in why
    assert f"d1: launch hold: {why}" in steep.words()


def test_the_canary_in_a_wind_just_below_it_is_launched(far_ready, limit_mps):
    site = far_ready(rising(limit_mps - 0.5, 0.0), 10.0)
    assert site.holds() == {}
    assert site.wire.launches() == [f"{FAR}.1:launch1"]


@pytest.mark.sample
def test_it_is_the_hour_of_the_launch_that_counts_and_the_hold_ends_when_the_wind_does(
    far_ready, limit_mps
):
    site = far_ready(lambda hour: (limit_mps + 1.0, limit_mps - 1.5)[min(hour, 1)], 60.0)
    (why,) = site.holds().values()
    assert "; again from 12:" in why or "; again from 13:" in why
    assert site.run(3600.0, lambda: site.wire.launches() != [])
    # The wind is linear in time and falls below the limit after this share of the hour.
    below_s = 1000.0 + 3600.0 / 2.5
    assert below_s - 900.0 < site.clock.t_s < below_s + 300.0
    assert "d1: launch hold for the wind ended" in site.words()


@pytest.mark.sample
def test_closings_are_said_ahead_by_order_and_time(depot, limit_mps):
    site = depot(rising(limit_mps - 4.0, 4.0))  # closes at 13:00 minus the flight time
    site.run(120.0)
    line = next(w for _, w in site.said if FAR in w and w.startswith("after 12:"))
    closes_s = 60.0 * int(line[9:11])
    speed_at = lambda t_s: limit_mps - 4.0 + 4.0 * t_s / 3600.0  # noqa: E731
    takes_s = 600.0  # upper bound for all harbour flights
    assert speed_at(closes_s) < limit_mps
    assert speed_at(closes_s + 300.0 + takes_s) >= limit_mps - 0.1
    assert "may not be launched: the forecast has " in line
    assert "m/s at 40 m" in line
    count = len(site.said)
    site.run(300.0)
    assert [w for _, w in site.said[count:] if FAR in w] == []  # logged once


def test_what_is_closed_is_given_to_nobody_and_what_closes_soon_goes_first(depot, limit_mps):
    calm = depot(rising(4.0, 0.0))
    assert promised(calm.data, NEAR, limit_mps + 0.5)
    soon = depot(rising(limit_mps - 1.0, 2.0), assigns_orders=True, orders_launches=False)
    soon.phase = "checks"  # not free yet
    soon.run(60.0)
    soon.phase = "standby"
    soon.run(20.0)
    (first,) = [row.order_id for row in soon.store.assignments()]
    # By the desk's filter these two harbour orders close first, and they are the furthest.
    assert first in (FAR, "H-107"), "the canary: without a forecast the nearest goes first"


def test_what_is_closed_now_is_assigned_to_nobody(depot):
    calm = depot(rising(4.0, 0.0))
    shut = {o.id for o in calm.data.orders if not promised(calm.data, o.id, 16.0)}
    assert FAR in shut
    site = depot(rising(16.0, 0.0), assigns_orders=True, orders_launches=False)
    site.phase = "checks"
    site.run(60.0)
    site.phase = "standby"
    site.run(20.0)
    (first,) = [row.order_id for row in site.store.assignments()]
    assert first not in shut
    closed = next(words for _, words in site.said if FAR in words and "not be launched" in words)
    assert not closed.startswith("after")
    assert "the forecast has 16.0 m/s at 40 m" in closed


@pytest.mark.sample
def test_a_launch_that_stays_closed_is_given_back_and_a_person_may_let_it_go(far_ready, limit_mps):
    site = far_ready(rising(limit_mps + 1.0, 0.5), forecast_watch.MIN_CLOSURE_S - 30.0)
    assert "withdrawn" not in site.words()
    site.run(60.0)
    assert f"{FAR}.1: withdrawn: order {FAR} is not launched" in site.words()


@pytest.mark.sample
def test_what_a_person_releases_is_launched_and_not_given_back(depot, limit_mps):
    site = depot(rising(limit_mps + 1.0, 0.5))
    site.aboard(FAR)
    site.run(60.0)
    assert "d1" in site.holds()
    HoldStore(site.store.database, site.clock.epoch_us).clear_holds(["d1"], "anna")
    site.phase = "ready"
    site.run(forecast_watch.MIN_CLOSURE_S + 60.0)
    assert site.wire.launches()[0] == f"{FAR}.1:launch1"  # each that it does not fly expires
    assert "withdrawn" not in site.words()


def test_a_front_holds_a_launch_whose_forecast_hold_a_person_released(
    depot, limit_mps, monkeypatch
):
    site = depot(rising(limit_mps + 1.0, 0.5))
    site.aboard(FAR)
    site.run(60.0)
    HoldStore(site.store.database, site.clock.epoch_us).clear_holds(["d1"], "anna")
    felt = WindChange("d9", site.clock.t_s, (0.0, -600.0), (0.0, 9.0), (0.0, 12.0), 80.0)
    monkeypatch.setattr(
        SiteWind,
        "drop_expired_and_get_fronts",
        lambda _, now_s: [made_front(now_s, replace(felt, t_s=now_s))],
    )
    site.phase = "ready"
    site.run(forecast_watch.MIN_CLOSURE_S + 60.0)
    assert "a front" in site.holds()["d1"]
    assert site.wire.launches() == []
    assert "withdrawn" not in site.words()


@pytest.mark.sample
def test_a_newer_file_is_taken_a_torn_or_wrong_one_is_said_and_the_old_one_stays(
    far_ready, limit_mps, tmp_path
):
    site = far_ready(rising(limit_mps + 1.0, 0.0), 30.0)
    assert "d1" in site.holds()
    path = tmp_path / "w.json"
    calm = written(tmp_path / "n.json", answer(lambda hour, _: (4.0, FROM_DEG))).read_text()
    path.write_text(calm[: len(calm) // 2])
    site.run(40.0)
    assert "WARNING: forecast rejected, keeping the current one: " in site.words()
    far_away = answer(lambda hour, _: (4.0, FROM_DEG)) | {"latitude": 48.0}
    written(path, far_away)
    site.run(40.0)
    assert "km from the forecast's point" in site.words()
    assert "d1" in site.holds()
    path.write_text(calm)
    assert site.run(forecast_watch.MIN_CLOSURE_S + 60.0, lambda: site.wire.launches() != [])
    assert "a newer forecast: 4.0 m/s from 80 at 40 m now" in site.words()


@pytest.mark.sample
def test_a_file_that_is_never_read_to_its_end_holds_the_desk_up_by_nothing_and_is_said_once(
    store, tmp_path
):
    """The file is a named pipe without a writer. If the desk's own thread reads it, a watchdog ends
    the read.
    """
    path = tmp_path / "w.json"
    data = day_of(path, rising(4.0, 0.0))
    store.add_orders_unless_conflict(data.orders)
    site = Depot(store, data)
    site.run(15.0)
    os.mkfifo(tmp_path / "pipe")
    os.replace(tmp_path / "pipe", path)
    ended = threading.Event()

    def end() -> None:
        ended.set()
        descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        path.unlink()  # not opened again
        os.close(descriptor)

    watchdog = threading.Timer(30.0, end)
    watchdog.start()
    try:
        site.run(30.0)
        reader = reader_of(site)
        assert reader.is_alive()
        site.run(READ_TIMEOUT_S + 600.0)
        assert not ended.is_set(), "the desk waited for the file"
        assert reader.exitcode == -signal.SIGKILL
        assert site.desk.exchange.status.status_of("d1").received_s == site.clock.t_s
        assert site.words().count("forecast rejected") == 1
        assert f"WARNING: forecast rejected, keeping the current one: {path}: not read: " in (
            site.words()
        )
    finally:
        watchdog.cancel()
        site.desk.close()


@pytest.mark.sample
def test_a_newer_file_is_read_by_a_process_beside_the_desk_which_ends_with_it(store, tmp_path):
    path = tmp_path / "w.json"
    data = day_of(path, rising(4.0, 0.0))
    store.add_orders_unless_conflict(data.orders)
    site = Depot(store, data)
    site.run(15.0)

    def put(speed_mps: float) -> SpawnProcess:
        newer = written(tmp_path / "n.json", answer(lambda hour, _: (speed_mps, FROM_DEG)))
        newer.replace(path)
        site.run(30.0)
        return reader_of(site)

    def says(words: str) -> None:
        assert site.desk.wind is not None
        until_s = time.monotonic() + 60.0
        while words not in site.words() and time.monotonic() < until_s:
            site.desk.wind.update_and_report_hold_change(site.desk.exchange.status)
            time.sleep(0.02)
        assert words in site.words()

    put(7.0)
    says("a newer forecast: 7.0 m/s from 80 at 40 m now")
    os.kill(put(8.0).pid or 0, signal.SIGKILL)
    says(f"keeping the current one: {path}: not read: its process died")
    put(9.0)
    says("a newer forecast: 9.0 m/s")
    last = put(10.0)
    site.desk.close()
    assert last.exitcode is not None
    assert "10.0 m/s" not in site.words()


def reader_of(site: Depot) -> SpawnProcess:
    """Return the process that currently reads the new file."""
    assert site.desk.wind is not None
    assert site.desk.wind.forecast_monitor is not None
    assert site.desk.wind.forecast_monitor.file_monitor is not None
    reader = site.desk.wind.forecast_monitor.file_monitor.reader
    assert isinstance(reader, ProcessWorker)
    assert reader.process is not None
    return reader.process


@pytest.mark.sample
def test_where_the_forecast_is_off_the_fleet_is_believed_and_that_is_said(depot, limit_mps):
    """The forecast is calm; airborne vehicles measure more wind than the far order permits."""
    site = depot(rising(2.0, 0.0))
    east = -(limit_mps + 2.0) * 0.985  # from 80 degrees
    north = -(limit_mps + 2.0) * 0.174
    site.detections = (north, east)
    site.run(600.0)
    site.aboard(FAR)
    site.phase = "ready"
    site.run(60.0)
    said = site.words()
    assert "FORECAST OFF: off by " in said
    assert "using the fleet's wind" in said
    assert "d1" in site.holds(), "canary: by the file alone it would be launched"
    assert site.wire.launches() == []


@pytest.mark.sample
def test_a_forecast_that_was_right_is_said_to_be_after_half_an_hour(depot):
    site = depot(rising(5.0, 0.0))
    site.detections = (-5.0 * 0.174, -5.0 * 0.985)
    site.run(forecast_watch.SCORE_LOG_INTERVAL_S + 120.0)
    line = next(w for _, w in site.said if w.startswith("the forecast of the last half hour"))
    assert "its own error 2.0" in line
    assert "FORECAST OFF" not in site.words()


def test_a_limit_of_the_wind_aloft_closes_by_the_forecast_before_anybody_feels_it(far_ready):
    site = far_ready(rising(9.0, 0.0), 60.0, NEAR, limit_mps=8.0)
    assert site.wire.launches() == []
    assert "the forecast has 9.0 m/s at 40 m, the limit is 8.0" in site.holds()["d1"]


def test_past_its_end_the_forecast_closes_nothing_and_that_is_said(depot, limit_mps):
    site = depot(rising(limit_mps + 1.0, 0.0))
    site.clock.t_s += 6.0 * 3600.0
    site.aboard(FAR)
    site.phase = "ready"
    site.run(30.0)
    assert "WARNING: the forecast does not cover the present" in site.words()
    assert site.holds() == {}


def test_a_day_that_names_no_file_follows_nothing(store):
    data = read_day(DAYS / "harbour.toml", ForecastRequest(keep_forecast=True))
    assert data.forecast is None
    store.add_orders_unless_conflict(data.orders)
    site = Depot(store, data)
    site.aboard(FAR)
    site.phase = "ready"
    site.run(10.0)
    assert site.wire.launches() == [f"{FAR}.1:launch1"]
