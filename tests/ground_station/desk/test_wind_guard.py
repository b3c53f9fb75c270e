"""A desk that watches the wind: launches held for a front and for wind aloft, and in time.

Four drones in the air tell a wind that the test makes; one with an order waits on the ground.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.core.wind_field.fronts import FeltChange
from companion.fleet.messages import Answered, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.app.desk.wind_guard import AFTER_RESTART_S
from ground_station.core.dispatch.wind_holds import (
    AGAIN_SHARE,
    CALM_S,
    HELD_BY,
    would_catch,
)
from ground_station.core.dispatch.wind_holds import (
    Launch as ToLaunch,
)
from ground_station.core.feasibility.wind_limit import LIMIT_SHARE, limit_of
from ground_station.core.fleet.fleet_link import LivelinessChanged, StateReceived
from ground_station.core.schema.holds import ALL
from tests.companion.wind_field.made_front import made_front
from tests.ground_station.desk.test_held_launches import Wire
from tests.ground_station.store.test_order_store import opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
DEPOT = (DAY.day.depot.lat_deg, DAY.day.depot.lon_deg)
M_PER_DEG = 111_320.0
ALERT_S = 10.0
"""What the issue asks: from the first drone that feels it to the hold."""

TELLERS = {
    "t1": (0.0, -1800.0),
    "t2": (500.0, -900.0),
    "t3": (-400.0, -200.0),
    "t4": (200.0, 800.0),
}
FLIES, WAITS = "d2", "d1"
AT = {**TELLERS, FLIES: (-100.0, -600.0), WAITS: (0.0, 0.0)}


class Clock:
    """A desk's clock that is set by hand."""

    def __init__(self) -> None:
        self.t_s = 1000.0

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return round(self.t_s * 1e6)


class Site:
    """The desk, its fleet on a wire, and the wind."""

    def __init__(self, store: Store) -> None:
        self.store, self.clock, self.said = store, Clock(), list[tuple[float, str]]()
        self.rng = np.random.default_rng(11)
        self.gust = {name: np.zeros(2) for name in AT}
        self.mean = {name: np.array([0.0, 5.0]) for name in AT}
        self.phase, self.left_wh = "checks", 90.0
        self.silent: set[str] = set()
        self.start()

    def start(self, *, confirms: bool = False) -> None:
        """A desk over the same store; drones are heard anew."""
        self.wire = Wire()
        params = DepotParams(assigns=False, launch_gap_s=0.0, confirms=confirms)
        say = lambda words: self.said.append((self.clock.t_s, words))  # noqa: E731
        self.desk: Desk = open_depot_desk(DAY, self.store, self.wire, say, params, clock=self.clock)
        self.wire.heard += [LivelinessChanged(name, name, up=True) for name in AT]

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
            vehicle=name, life=name, uptime_s=self.clock.t_s, epoch_us=self.clock.epoch_us(),
            airframe="m100", max_payload_kg=1.0, log=name, last_seq=0,
            phase=self.phase if name == WAITS else "outbound",
            assignment={WAITS: "H-101.1", FLIES: "H-104.1"}.get(name),
            lat_deg=DEPOT[0] + north / M_PER_DEG,
            lon_deg=DEPOT[1] + east / M_PER_DEG / math.cos(math.radians(DEPOT[0])),
            **({"armed": False, "height_rel_m": 0.0} | told),
        )  # fmt: skip

    def run(self, for_s: float, until=lambda: False) -> bool:
        """A second at a time; whether `until` came true."""
        for _ in range(round(for_s)):
            self.clock.t_s += 1.0
            for name in AT:
                self.gust[name] += -self.gust[name] / 15.0 + self.rng.normal(0.0, 0.15, 2)
                if name not in self.silent:
                    self.wire.heard.append(StateReceived(self.state(name)))
            self.desk.turn(0.0)
            if until():
                return True
        return False

    def front(
        self, change_mps: float, speed_mps: float, for_s: float, until=lambda: False
    ) -> float:
        """A front towards the east, at the first drone now; when that felt it."""
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
        return {hold.scope: hold.reason for hold in self.store.holds() if hold.by == HELD_BY}

    def launches(self) -> list[str]:
        return self.wire.launches()

    def words(self) -> str:
        return "\n".join(words for _, words in self.said)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        store.add_orders(DAY.orders)
        for order, vehicle in (("H-101", WAITS), ("H-104", FLIES)):
            id_ = store.assign(order, vehicle, {"format": "flight/1"}, None, "desk")
            assert id_ is not None
            store.answered(f"{id_}:assign", Answered.DONE, "", vehicle)
        assert store.assign("H-108", "truck", {"format": "flight/1"}, None, "desk") is not None
        assert store.launch("H-104.1", "desk")
        store.answered("H-104.1:launch1", Answered.DONE, "", FLIES)
        yield Site(store)


def test_a_launch_that_a_front_would_catch_is_held_in_ten_seconds_and_goes_when_it_has_passed(
    site: Site,
):
    site.run(150.0)
    assert site.holds() == {}
    began_s = site.front(9.0, 12.0, 60.0, lambda: bool(site.holds()))
    assert site.clock.t_s - began_s <= ALERT_S
    assert list(site.holds()) == [WAITS], "a truck drives in any wind"
    assert "felt by t1" in site.holds()[WAITS]
    told = next(words for _, words in site.said if words.startswith("FRONT"))
    assert "the depot in" in told  # whom it has not reached, and when it comes
    assert f"{FLIES} in" in told
    site.phase = "ready"
    due_s = began_s + (AT["t4"][1] - AT["t1"][1]) / 12.0  # 217 s: past all places of its flight
    site.front(0.0, 12.0, 60.0)
    assert site.launches() == []
    assert site.run(900.0, lambda: site.holds() == {})
    assert site.clock.t_s > began_s + (0.0 - AT["t1"][1]) / 12.0, "not before it has passed"
    assert site.clock.t_s < due_s + 400.0
    site.run(3.0)
    assert site.launches() == ["H-101.1:launch1"]  # nobody had to release anybody
    assert "no longer held for the wind" in site.words()


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
    assert "FRONT withdrawn, felt by t1" in site.words()
    assert "no longer held for the wind" in site.words()


def test_the_canary_without_a_front_it_is_launched_at_once(site: Site):
    site.run(150.0)
    site.phase = "ready"
    site.run(20.0)
    assert site.launches() == ["H-101.1:launch1"]
    assert site.store.holds() == []


@pytest.mark.parametrize(
    ("left_wh", "words"), [(90.0, "Wh to spare behind it"), (36.0, "recall it"), (12.0, "look at")]
)
def test_who_flies_in_its_way_is_judged_anew_in_ten_seconds(site: Site, left_wh, words):
    site.left_wh = left_wh
    site.run(150.0)
    began_s = site.front(9.0, 12.0, 20.0)
    when_s, said = next(one for one in site.said if f"{FLIES}: in the front's way" in one[1])
    assert when_s - began_s <= ALERT_S
    assert words in said


def test_wind_aloft_over_the_limit_stops_all_launches_in_ten_seconds_and_they_go_on_in_calm(
    site: Site,
):
    limit_mps = limit_of(DAY)
    assert limit_mps == pytest.approx(16.0, abs=0.3)  # 0.75 of the M100's 21.3
    site.run(100.0)
    for mean in site.mean.values():
        mean[:] = (0.0, 0.8 * limit_mps)
    site.run(60.0)
    assert ALL not in site.holds()
    site.mean["t3"][:] = (0.0, limit_mps + 1.5)
    began_s = site.clock.t_s
    site.phase = "ready"
    assert site.run(20.0, lambda: ALL in site.holds())
    assert site.clock.t_s - began_s <= ALERT_S
    assert "wind aloft" in site.holds()[ALL]
    assert "by t3 at 60 m" in site.holds()[ALL]
    site.run(60.0)
    site.mean["t3"][:] = (0.0, 0.9 * limit_mps)  # below the limit, not below where it goes on
    site.run(CALM_S + 100.0)
    assert ALL in site.holds()
    assert AGAIN_SHARE < 0.9
    assert site.launches() == []
    for mean in site.mean.values():
        mean[:] = (0.0, 0.6 * limit_mps)
    assert site.run(CALM_S + 60.0, lambda: ALL not in site.holds())
    site.run(3.0)
    assert site.launches() == ["H-101.1:launch1"]


def test_a_person_may_release_it_and_what_a_person_holds_is_not_lifted(site: Site):
    people = HoldStore(site.store.database, site.clock.epoch_us)
    site.run(100.0)
    for mean in site.mean.values():
        mean[:] = (0.0, limit_of(DAY) + 2.0)
    assert site.run(20.0, lambda: ALL in site.holds())
    people.release([ALL], "anna")
    site.run(60.0)
    assert ALL not in site.holds(), "not set again for the same reason"
    people.set([ALL], "lunch", "anna")
    for mean in site.mean.values():
        mean[:] = (0.0, 2.0)
    site.run(CALM_S + 60.0)
    assert [hold.by for hold in site.store.holds()] == ["anna"]


def test_a_persons_word_of_before_is_void_and_asked_for_again(site: Site):
    """Who saw the pad minutes ago has not seen it now."""
    site.start(confirms=True)
    asks = "d1: ready: `ground-station order launch H-101` lets it go"
    site.run(60.0)
    assert site.store.confirm_launch("H-101", "anna") == "H-101.1"
    site.mean["t3"][:] = (0.0, limit_of(DAY) + 2.0)
    assert site.run(5.0, lambda: ALL in site.holds())
    site.phase = "ready"
    assert site.store.confirm_launch("H-101", "anna") is None
    site.mean["t3"][:] = (0.0, 5.0)
    assert site.run(CALM_S + 60.0, lambda: ALL not in site.holds())
    site.run(3.0)
    assert site.launches() == []
    assert asks in site.words()
    site.store.confirm_launch("H-101", "anna")
    site.run(3.0)
    assert site.launches() == ["H-101.1:launch1"]


def test_a_hold_of_before_a_restart_ends_by_itself(site: Site):
    site.run(100.0)
    site.mean["t3"][:] = (0.0, limit_of(DAY) + 2.0)
    assert site.run(20.0, lambda: ALL in site.holds())
    site.silent = set(TELLERS) | {FLIES}  # all have landed: nobody tells that it is calm
    set_s = site.clock.t_s
    site.start()
    site.run(AFTER_RESTART_S - 60.0)
    assert ALL in site.holds()
    assert site.run(120.0, lambda: ALL not in site.holds())
    assert site.clock.t_s - set_s == pytest.approx(AFTER_RESTART_S, abs=5.0)


def test_a_flight_that_is_over_before_a_front_comes_is_not_caught():
    felt = FeltChange("t1", 0.0, (0.0, -20_000.0), (0.0, 9.0), (0.0, 12.0), 80.0)
    front = made_front(0.0, felt)
    comes_s, std_s = front.arrives((0.0, 0.0))
    early = ToLaunch("d1", ((0.0, 0.0), (0.0, -300.0)), 200.0)
    assert comes_s - 2.0 * std_s > 220.0
    assert not would_catch(front, early, 0.0)
    assert would_catch(front, replace(early, takes_s=comes_s), 0.0)
    assert not would_catch(front, early, comes_s + 3.0 * std_s + 100.0)


def test_a_day_may_state_its_limit():
    day = msgspec.structs.replace(DAY.day, wind_limit_mps=9.0)
    assert limit_of(replace(DAY, day=day)) == 9.0
    assert limit_of(DAY) > LIMIT_SHARE * 15.0
