"""One vehicle, two assignments, a truck in between: switched off where it landed, switched on with
a full pack at the next pad. The companion keeps running and carries no state over.
"""

import math
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.adapters.files.params import params_dir, read_airframe
from companion.app.flight.fleet_port import FleetPort
from companion.core.pilot.context import PilotOptions
from companion.fleet.messages import (
    Assign,
    Command,
    CommandAction,
    CommandStatus,
    EventKind,
    FleetEvent,
    Launch,
    MoveHome,
    Result,
    decode_message,
    encode_message,
)
from companion.fleet.network import MemberRequest, RequestKind
from sim_bridge.app.day.companion import SteppedCompanion
from sim_bridge.app.day.drone import DayDrone, DroneWorld
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.terrain import PlaneTerrain
from sim_bridge.truth.wind_params import build_mean_wind, parse_wind
from tests.fleet.wire import Wire, valid_from

pytestmark = pytest.mark.sitl

SITE = (55.47, 8.45, 12.0)
M_PER_DEG = 111_194.93
PADS = {"stop-1": (0.0, 0.0), "stop-2": (70.0, 60.0)}  # north, east of the first launch pad
CUSTOMER = (110.0, -20.0)
STEP_S, STEPS = 0.1, 10


def place(name: str, ne_m: tuple[float, float]) -> dict[str, Any]:
    north, east = ne_m
    lon = SITE[1] + east / M_PER_DEG / math.cos(math.radians(SITE[0]))
    return {
        "name": name,
        "lat_deg": SITE[0] + north / M_PER_DEG,
        "lon_deg": lon,
        "alt_amsl_m": 12.0,
    }


def assignment(id_: str, start: str, home: str) -> Assign:
    depot = {k: v for k, v in place("", PADS[start]).items() if k != "name"}
    site = {
        "depot": depot,
        "customer": place("customer", CUSTOMER),
        "stops": [place(name, pad) for name, pad in PADS.items()],
        "home": home,
    }
    mission = {"cruise_height_m": 20.0, "wind_settle_s": 3.0, "leg_length_m": 80.0}
    vehicle = {"airframe": "m100", "payload_kg": 0.5, "charge_frac": [0.3, 1.0]}
    flight = {"format": "flight/1", "site": site, "vehicle": vehicle, "mission": mission}
    return Assign(assignment=id_, order=f"order-{id_}", flight=flight)


class Desk(Wire):
    """The other end of the vehicle's link: received states, and commands to it."""

    def __init__(self) -> None:
        super().__init__()
        self.results: list[Result] = []
        self.sent = 0

    def order(self, deed: CommandAction) -> None:
        now = self.states[-1]
        self.sent += 1
        command = Command(
            id=f"c{self.sent}",
            vehicle="d1",
            instance_id=now.instance_id,
            as_of_s=now.uptime_s,
            by="desk",
            action=valid_from(deed, now.instance_id, now.uptime_s),
        )
        self.waiting.append(
            MemberRequest(RequestKind.COMMAND, self._on_command_answered, encode_message(command))
        )

    def _on_command_answered(self, replies: list[bytes]) -> None:
        result = decode_message(Result, replies[0])
        assert isinstance(result, Result)
        self.results.append(result)

    def outcome(self, id_: str) -> FleetEvent | None:
        ended = (e for e in self.events if e.kind is EventKind.OUTCOME and e.assignment == id_)
        return next(ended, None)


class Scene:
    """A drone, the desk, and a companion that keeps running while the drone is off."""

    def __init__(self, folder: Path, autopilot_kind: str) -> None:
        self.t_s = 0.0
        self.desk = Desk()
        port = FleetPort.open(
            "d1", "m100", read_airframe("m100"), folder, lambda life: self.desk,
            clock_s=lambda: self.t_s,
        )  # fmt: skip
        self.companion = SteppedCompanion(
            port=port,
            airframe="m100",
            clock_s=lambda: self.t_s,
            pilot=PilotOptions(configure=True),
        )
        wind = parse_wind({"kind": "steady", "speed_mps": 3.0, "from_deg": 250.0})
        world = DroneWorld(SITE, PlaneTerrain(), wind, build_mean_wind(wind, folder))
        self.drone = DayDrone(
            "d1", 1, autopilot_kind, load_airframe(params_dir() / "truth" / "m100.toml"), 20.0, 1.0,
            (0.9, 0.9), world, folder, np.random.SeedSequence(3), lambda drone: self.companion,
        )  # fmt: skip

    @property
    def lies_at(self) -> tuple[float, float]:
        """Return its true position."""
        assert self.drone.power_cycle is not None
        north, east, _ = self.drone.power_cycle.vehicle.truth.pos_ned_m
        return north, east

    def switch_off_and_end_power_cycle(self) -> None:
        self.drone.companion = None  # it has a separate supply
        self.drone.switch_off_and_end_power_cycle()

    def run(self, until: Callable[[], object], limit_s: float) -> None:
        end_s = self.t_s + limit_s
        while not until():
            assert self.t_s < end_s, (self.desk.states[-1], self.desk.events[-3:])
            self.t_s = round(self.t_s + STEP_S, 3)
            self.drone.advance_and_exchange_messages(self.t_s, STEPS)
            if self.drone.power_cycle is None:
                self.companion.process_datagrams([])

    def fly(self, start: str, home: str, id_: str, also: Callable[[], None] = lambda: None) -> None:
        desk = self.desk
        self.run(lambda: desk.states and desk.states[-1].armed is False, 40.0)
        desk.order(assignment(id_, start, home))
        self.run(lambda: desk.states[-1].phase == "ready", 90.0)
        self.launched = desk.states[-1]
        desk.order(Launch(assignment=id_))
        self.run(lambda: desk.states[-1].phase == "outbound", 90.0)
        also()
        self.run(lambda: desk.outcome(id_), 200.0)


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    """ArduCopter: after a restart it sends only heartbeats until telemetry is requested again."""
    made = Scene(tmp_path, "ardupilot")
    yield made
    made.companion.stop()


@pytest.mark.sample
def test_safety_rule_3_from_stop_to_stop_and_on_from_there_with_a_fresh_pack(scene):
    desk = scene.desk
    scene.drone.switch_on_at_pad(0.0, PADS["stop-1"], 0.5, None)
    scene.fly("stop-1", "stop-2", "a1")
    first, at_first = desk.outcome("a1"), scene.lies_at
    assert first is not None
    assert (first.outcome, first.home) == ("SUC", True)
    assert math.dist(at_first, PADS["stop-2"]) < 5.0
    assert {s.home for s in desk.states if s.assignment == "a1"} == {"stop-2"}
    left_wh = [s.energy_left_wh for s in desk.states if s.energy_left_wh is not None][-1]

    scene.switch_off_and_end_power_cycle()
    scene.run(lambda: desk.states[-1].armed is None, 20.0)
    gone = desk.states[-1]
    assert (gone.lat_deg, gone.voltage_v, gone.phase) == (None, None, "standby")

    scene.drone.switch_on_at_pad(scene.t_s, PADS["stop-2"], 0.5, None)

    def move() -> None:
        desk.order(MoveHome(assignment="a1", home="stop-2"))  # of the previous flight
        desk.order(MoveHome(assignment="a2", home="stop-2"))
        scene.run(lambda: desk.states[-1].home == "stop-2", 100.0)
        desk.order(MoveHome(assignment="a2", home="stop-1"))  # and back again

    scene.fly("stop-2", "stop-1", "a2", move)
    told = scene.launched
    assert told.energy_left_wh is not None
    assert told.energy_left_wh > left_wh + 5.0
    assert told.lat_deg == pytest.approx(SITE[0] + PADS["stop-2"][0] / M_PER_DEG, abs=1e-4)
    answers = [result.status for result in desk.results[-3:]]
    assert answers == [CommandStatus.REFUSED, CommandStatus.DONE, CommandStatus.DONE]
    second, at_second = desk.outcome("a2"), scene.lies_at
    assert second is not None
    assert (second.outcome, second.home) == ("SUC", True)
    assert math.dist(at_second, PADS["stop-1"]) < 5.0
    # The truck stays bound to a stop until the vehicle reports another end.
    homes = [s.home for s in desk.states if s.assignment == "a2"]
    assert [home for home, _ in groupby(homes)] == ["stop-1", "stop-2", "stop-1"]
    outward = {s.home for s in desk.states if s.assignment == "a2" and s.phase == "outbound"}
    assert outward == {"stop-1"}
