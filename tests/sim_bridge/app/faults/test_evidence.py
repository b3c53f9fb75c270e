"""Every row states an effect that is missing where its injection does nothing.

Each procedure runs on a vehicle on which nothing can be changed: assignments and calls have no
effect, and no message crosses the link. That the effects occur is asserted by each flown row
(tests/sitl/test_faults.py).
"""

from enum import Enum
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from sim_bridge.app.day.desk import LOG_FILE
from sim_bridge.app.day.truck import DayTruck
from sim_bridge.app.fault_suite.catalogue import CATALOGUE
from sim_bridge.app.faults import computers
from sim_bridge.app.faults.day.fleet_day import FAULTED_DRONE
from sim_bridge.app.faults.fault import FLEET_GROUP, FaultCase
from sim_bridge.app.faults.runner import write_changed_flight_file
from sim_bridge.app.flight.craft_building import FlyOptions, build_single_craft
from sim_bridge.app.flight.stage import FaultContext, describe_missing_effects
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.mavlink.enums import Cmd
from sim_bridge.autopilot.mission.items import MissionItem

STEPS = 200
"""Steps of a procedure: 20 s of a flight, 200 s of a day."""

PLAIN = (int, float, str, bytes, bool, type(None), tuple, list, dict, set, Enum, Path)
ITEMS = [
    MissionItem(command, 6, x=554700000 + 1000 * k, y=84500000, z=30.0)
    for k, command in enumerate((Cmd.NAV_WAYPOINT, Cmd.NAV_TAKEOFF, *[Cmd.NAV_WAYPOINT] * 3))
] + [MissionItem(Cmd.NAV_LAND, 6, x=554700000, y=84500000, z=0.0)]


class Unchangeable:
    """A view of an object: attributes can be read; methods and assignments do nothing."""

    def __init__(self, target: Any) -> None:
        object.__setattr__(self, "_target", target)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._target, name)
        if isinstance(value, PLAIN):
            return value
        return value if name in READING_METHODS else Unchangeable(value)

    def __call__(self, *given: object, **named: object) -> None:
        pass

    def __setattr__(self, name: str, value: object) -> None:
        pass

    def __getitem__(self, key: str) -> object:
        return self._target[key]


READING_METHODS = ("mean_wind_to_ne_mps",)


def stage_of_unchangeable_vehicle(case: FaultCase, autopilot: str, folder: Path) -> FaultContext:
    options = FlyOptions(write_changed_flight_file(folder / "f.toml"), autopilot)
    craft = build_single_craft(options, "udpout:127.0.0.1:9", folder)
    craft.host.advance(1)
    craft.autopilot.store.mission = list(ITEMS)
    craft.autopilot.state.mode = Mode.AUTO
    craft.autopilot.state.is_armed = case.name != "reboot-on-the-ground"
    craft.companion = MagicMock(is_running=True, is_stopped=False, start_count=1, arguments=[])
    craft.operator.accepted = True
    texts = ("mission restored", "ready: mission uploaded and verified")
    craft.operator.received_texts = [(1.0, text) for text in texts]
    for name in ("checkpoint.json", "decisions.mcap"):
        (folder / name).write_bytes(bytes(99))
    view: Any = Unchangeable(craft)
    return FaultContext(
        case.phases[0],
        np.random.default_rng(1),
        lambda: True,
        None,
        craft_and_lockstep=(view, MagicMock()),
    )


def unchangeable_day(folder: Path) -> SimpleNamespace:
    (folder / LOG_FILE).touch()
    first = MagicMock(desk=MagicMock(), folder=folder)
    truck = MagicMock(spec=DayTruck, added_delay_s=0.0)
    clock = SimpleNamespace(monotonic_s=lambda: 0.0, epoch_us=lambda: 10**15)
    desks = MagicMock(first_desk=first, desks=[first])
    drone = MagicMock()
    drone.power_cycle.vehicle.pos_ned_m = (0.0, 0.0, 0.0)
    return SimpleNamespace(
        desks=desks,
        bus=MagicMock(lost=0, states={FAULTED_DRONE: SimpleNamespace(epoch_us=10**15)}),
        world=SimpleNamespace(ground_handling=truck, clock=clock),
        faulted_drone=drone,
        faulted_drone_flight_phase=None,
    )


def advance(stage: FaultContext, step_s: float) -> None:
    for step in range(STEPS):
        if not stage.continue_procedure(step * step_s):
            break
    stage.resources.close()


FLOWN = [(case, kind) for case in CATALOGUE for kind in case.autopilots]


@pytest.mark.parametrize(
    ("case", "autopilot"), FLOWN, ids=lambda given: getattr(given, "name", given)
)
def test_a_row_whose_injection_does_nothing_is_not_held(case, autopilot, tmp_path, monkeypatch):
    second = MagicMock(has_replied=False)
    second.process.is_running = False
    monkeypatch.setattr(computers, "SecondCompanion", lambda *given: second)
    if case.group == FLEET_GROUP:
        stage = FaultContext(case.phases[0], np.random.default_rng(1), lambda: True, None)
        stage.remaining_steps = case.procedure(stage, unchangeable_day(tmp_path))
        advance(stage, 1.0)
    else:
        stage = stage_of_unchangeable_vehicle(case, autopilot, tmp_path)
        stage.remaining_steps = case.procedure(stage)
        advance(stage, 0.1)
    assert stage.expected_effects
    assert describe_missing_effects(stage)
    assert any(not e.held_before_injection and not e.was_observed for e in stage.expected_effects)
