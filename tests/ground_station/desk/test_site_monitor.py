"""A desk that monitors the wind: it holds launches for a front and for wind aloft, in time.

Four airborne drones report a wind set by the test; one with an order waits on the ground.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.core.wind_field.fronts import WindChange
from companion.fleet.messages import CommandStatus, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.app.desk.site.launch_holds import ADOPTED_HOLD_DURATION_S
from ground_station.core.dispatch.hold_source import HoldSource
from ground_station.core.dispatch.wind_holds import (
    CALM_S,
    RESUME_FRACTION,
    may_be_hit_by_front,
)
from ground_station.core.dispatch.wind_holds import (
    PlannedLaunch as ToLaunch,
)
from ground_station.core.feasibility.wind_limit import WIND_LIMIT_FRAC, launch_wind_limit_mps
from ground_station.core.fleet.fleet_link import LivelinessChanged, StateReceived
from ground_station.core.schema.holds import ALL_DRONES
from tests.companion.wind_field.made_front import made_front
from tests.ground_station.desk_parts import HandClock, Wire
from tests.ground_station.store.test_order_store import opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
DEPOT = (DAY.day.depot.lat_deg, DAY.day.depot.lon_deg)
M_PER_DEG = 111_320.0
ALERT_S = 10.0
"""Required time from the first drone that measures the front to the hold."""

TELLERS = {
    "t1": (0.0, -1800.0),
    "t2": (500.0, -900.0),
    "t3": (-400.0, -200.0),
    "t4": (200.0, 800.0),
}
FLIES, WAITS = "d2", "d1"
AT = {**TELLERS, FLIES: (-100.0, -600.0), WAITS: (0.0, 0.0)}


class Site:
    """The desk, its fleet on a wire, and the wind."""

    def __init__(self, store: Store) -> None:
        self.store, self.clock, self.said = store, HandClock(1000.0), list[tuple[float, str]]()
        self.rng = np.random.default_rng(11)
        self.gust = {name: np.zeros(2) for name in AT}
        self.mean = {name: np.array([0.0, 5.0]) for name in AT}
        self.phase, self.left_wh = "checks", 90.0
        self.silent: set[str] = set()
        self.start()

    def start(self, *, confirms: bool = False) -> None:
        """Start a desk over the same store; all drones join again."""
        self.wire = Wire()
        params = DepotParams(assigns_orders=False, launch_gap_s=0.0, requires_confirmation=confirms)
        say = lambda words: self.said.append((self.clock.t_s, words))  # noqa: E731
        self.desk: Desk = open_depot_desk(DAY, self.store, self.wire, say, params, clock=self.clock)
        self.wire.heard += [LivelinessChanged(name, name, has_joined=True) for name in AT]

    def state(self, name: str) -> State:
        north, east = AT[name]
        told = {}
        if name != WAITS:
            wind = self.mean[name] + self.gust[name]
            told = {
                "armed": True, "height_rel_m": 60.0, "wind_cov_m2ps2": (0.3, 0.0, 0.3),
                "wind_to_n_mps": float(wind[0]), "wind_to_e_mps": float(wind[1]),
                "energy_left_wh": self.left_wh,
            }  # fmt: skip
        return State(
            vehicle=name, instance_id=name, uptime_s=self.clock.t_s, epoch_us=self.clock.epoch_us(),
            airframe="m100", max_payload_kg=1.0, log=name, last_seq=0,
            phase=self.phase if name == WAITS else "outbound",
            assignment={WAITS: "H-101.1", FLIES: "H-104.1"}.get(name),
            lat_deg=DEPOT[0] + north / M_PER_DEG,
            lon_deg=DEPOT[1] + east / M_PER_DEG / math.cos(math.radians(DEPOT[0])),
            **({"armed": False, "height_rel_m": 0.0} | told),
        )  # fmt: skip

    def run(self, for_s: float, until=lambda: False) -> bool:
        """Advance in steps of one second; return whether `until` became true."""
        for _ in range(round(for_s)):
            self.clock.t_s += 1.0
            for name in AT:
                self.gust[name] += -self.gust[name] / 15.0 + self.rng.normal(0.0, 0.15, 2)
                if name not in self.silent:
                    self.wire.heard.append(StateReceived(self.state(name)))
            self.desk.run_cycle(0.0)
            if until():
                return True
        return False

    def front(
        self, change_mps: float, speed_mps: float, for_s: float, until=lambda: False
    ) -> float:
        """Move a front eastward from the first drone; return the time it reached that drone."""
        began_s = self.clock.t_s
        due_s = {n: began_s + (at[1] - AT["t1"][1]) / speed_mps for n, at in AT.items()}
        for _ in range(round(for_s)):
            for name, t_s in due_s.items():
                if abs(self.clock.t_s - t_s) < 0.5:
                    self.mean[name] = self.mean[name] + (0.0, change_mps)
            if self.run(1.0, until):
                break
        return began_s

    def holds(self) -> dict[str, str]:
        return {
            hold.scope: hold.reason
            for hold in self.store.holds_in_force()
            if hold.by in tuple(HoldSource)
        }

    def launches(self) -> list[str]:
        return self.wire.launches()

    def words(self) -> str:
        return "\n".join(words for _, words in self.said)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        store.add_orders_unless_conflict(DAY.orders)
        for order, vehicle in (("H-101", WAITS), ("H-104", FLIES)):
            id_ = store.assign_order(order, vehicle, {"format": "flight/1"}, None, "desk")
            assert id_ is not None
            store.record_and_apply_response(f"{id_}:assign", CommandStatus.DONE, "", vehicle)
        assert (
            store.assign_order("H-108", "truck", {"format": "flight/1"}, None, "desk") is not None
        )
        assert store.launch("H-104.1", "desk")
        store.record_and_apply_response("H-104.1:launch1", CommandStatus.DONE, "", FLIES)
        yield Site(store)


@pytest.mark.sample
def test_a_launch_that_a_front_would_catch_is_held_in_ten_seconds_and_goes_when_it_has_passed(
    site: Site,
):
    site.run(150.0)
    assert site.holds() == {}
    began_s = site.front(9.0, 12.0, 60.0, lambda: bool(site.holds()))
    assert site.clock.t_s - began_s <= ALERT_S
    assert list(site.holds()) == [WAITS], "a truck drives in any wind"
    assert "detected by t1" in site.holds()[WAITS]
    told = next(words for _, words in site.said if words.startswith("FRONT"))
    assert "the depot in" in told  # places that it has not reached, with arrival times
    assert f"{FLIES} in" in told
    site.phase = "ready"
    due_s = began_s + (AT["t4"][1] - AT["t1"][1]) / 12.0  # 217 s: past all positions of its flight
    site.front(0.0, 12.0, 60.0)
    assert site.launches() == []
    assert site.run(900.0, lambda: site.holds() == {})
    assert site.clock.t_s > began_s + (0.0 - AT["t1"][1]) / 12.0, "not before it has passed"
    assert site.clock.t_s < due_s + 400.0
    site.run(3.0)
    assert site.launches() == ["H-101.1:launch1"]  # no manual release
    assert "launch hold for the wind ended" in site.words()


def test_a_front_that_is_withdrawn_holds_nobody_any_more(site: Site):
    site.run(150.0)
    gust = (0.0, 9.0)
    site.mean["t1"] = site.mean["t1"] + gust
    site.run(15.0)
    site.mean["t1"] = site.mean["t1"] - gust
    site.phase = "ready"
    assert list(site.holds()) == [WAITS]
    assert site.run(60.0, lambda: site.holds() == {})
    site.run(3.0)
    assert site.launches() == ["H-101.1:launch1"]
    assert "FRONT withdrawn, detected by t1" in site.words()
    assert "launch hold for the wind ended" in site.words()


def test_the_canary_without_a_front_it_is_launched_at_once(site: Site):
    site.run(150.0)
    site.phase = "ready"
    site.run(20.0)
    assert site.launches()[:1] == ["H-101.1:launch1"]
    assert site.store.holds_in_force() == []


@pytest.mark.parametrize(
    ("left_wh", "words"),
    [(90.0, "Wh above the reserve in the wind behind it"), (36.0, "recall it"), (12.0, "check it")],
)
def test_who_flies_in_its_way_is_judged_anew_in_ten_seconds(site: Site, left_wh, words):
    site.left_wh = left_wh
    site.run(150.0)
    began_s = site.front(9.0, 12.0, 20.0)
    when_s, said = next(one for one in site.said if f"{FLIES}: in the front's path" in one[1])
    assert when_s - began_s <= ALERT_S
    assert words in said


@pytest.mark.sample
def test_wind_aloft_over_the_limit_stops_all_launches_in_ten_seconds_and_they_go_on_in_calm(
    site: Site,
):
    limit_mps = launch_wind_limit_mps(DAY)
    assert limit_mps == pytest.approx(16.0, abs=0.3)  # 0.75 of the M100's 21.3
    site.run(100.0)
    for mean in site.mean.values():
        mean[:] = (0.0, 0.8 * limit_mps)
    site.run(60.0)
    assert ALL_DRONES not in site.holds()
    site.mean["t3"][:] = (0.0, limit_mps + 1.5)
    began_s = site.clock.t_s
    site.phase = "ready"
    assert site.run(20.0, lambda: ALL_DRONES in site.holds())
    assert site.clock.t_s - began_s <= ALERT_S
    assert "wind aloft" in site.holds()[ALL_DRONES]
    assert "by t3 at 60 m" in site.holds()[ALL_DRONES]
    site.run(60.0)
    site.mean["t3"][:] = (0.0, 0.9 * limit_mps)  # below the limit, above the release threshold
    site.run(CALM_S + 100.0)
    assert ALL_DRONES in site.holds()
    assert RESUME_FRACTION < 0.9
    assert site.launches() == []
    for mean in site.mean.values():
        mean[:] = (0.0, 0.6 * limit_mps)
    assert site.run(CALM_S + 60.0, lambda: ALL_DRONES not in site.holds())
    site.run(3.0)
    assert site.launches() == ["H-101.1:launch1"]


@pytest.mark.sample
def test_a_person_may_release_it_and_what_a_person_holds_is_not_lifted(site: Site):
    people = HoldStore(site.store.database, site.clock.epoch_us)
    site.run(100.0)
    for mean in site.mean.values():
        mean[:] = (0.0, launch_wind_limit_mps(DAY) + 2.0)
    assert site.run(20.0, lambda: ALL_DRONES in site.holds())
    people.clear_holds([ALL_DRONES], "anna")
    site.run(60.0)
    assert ALL_DRONES not in site.holds(), "not set again for the same reason"
    people.place_holds([ALL_DRONES], "lunch", "anna")
    for mean in site.mean.values():
        mean[:] = (0.0, 2.0)
    site.run(CALM_S + 60.0)
    assert [hold.by for hold in site.store.holds_in_force()] == ["anna"]


def test_a_persons_word_of_before_is_void_and_asked_for_again(site: Site):
    """A person's confirmation expires because the pad may have changed within minutes."""
    site.start(confirms=True)
    asks = "d1: ready: `ground-station order launch H-101` confirms the launch"
    site.run(60.0)
    assert site.store.record_launch_confirmation("H-101", "anna") == "H-101.1"
    site.mean["t3"][:] = (0.0, launch_wind_limit_mps(DAY) + 2.0)
    assert site.run(5.0, lambda: ALL_DRONES in site.holds())
    site.phase = "ready"
    assert site.store.record_launch_confirmation("H-101", "anna") is None
    site.mean["t3"][:] = (0.0, 5.0)
    assert site.run(CALM_S + 60.0, lambda: ALL_DRONES not in site.holds())
    site.run(3.0)
    assert site.launches() == []
    assert asks in site.words()
    site.store.record_launch_confirmation("H-101", "anna")
    site.run(3.0)
    assert site.launches() == ["H-101.1:launch1"]


@pytest.mark.sample
def test_a_hold_of_before_a_restart_ends_by_itself(site: Site):
    site.run(100.0)
    site.mean["t3"][:] = (0.0, launch_wind_limit_mps(DAY) + 2.0)
    assert site.run(20.0, lambda: ALL_DRONES in site.holds())
    site.silent = set(TELLERS) | {FLIES}  # all have landed: no reports of calm wind
    set_s = site.clock.t_s
    site.start()
    site.run(ADOPTED_HOLD_DURATION_S - 60.0)
    assert ALL_DRONES in site.holds()
    assert site.run(120.0, lambda: ALL_DRONES not in site.holds())
    assert site.clock.t_s - set_s == pytest.approx(ADOPTED_HOLD_DURATION_S, abs=5.0)


def test_a_flight_that_is_over_before_a_front_comes_is_not_caught():
    felt = WindChange("t1", 0.0, (0.0, -20_000.0), (0.0, 9.0), (0.0, 12.0), 80.0)
    front = made_front(0.0, felt)
    comes_s, std_s = front.arrival_time_and_std_s((0.0, 0.0))
    early = ToLaunch("d1", ((0.0, 0.0), (0.0, -300.0)), 200.0)
    assert comes_s - 2.0 * std_s > 220.0
    assert not may_be_hit_by_front(front, early, 0.0)
    assert may_be_hit_by_front(front, replace(early, max_duration_s=comes_s), 0.0)
    assert not may_be_hit_by_front(front, early, comes_s + 3.0 * std_s + 100.0)


def test_a_day_may_state_its_limit():
    day = msgspec.structs.replace(DAY.day, wind_limit_mps=9.0)
    assert launch_wind_limit_mps(replace(DAY, day=day)) == 9.0
    assert launch_wind_limit_mps(DAY) > WIND_LIMIT_FRAC * 15.0
