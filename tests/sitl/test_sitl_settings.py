"""Settings that an interrupted flight leaves changed on its vehicle, and their restoration."""

import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from companion.adapters.files.vehicle_settings import (
    read_original_parameters,
    write_or_remove_original_parameters,
)
from sim_bridge.app.world.vehicle_host import VehicleHost
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from tests.sitl.served import companion_done, on_the_ground

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(120)]

PARAMS = Path(__file__).parents[2] / "params"
BOTH = ["px4", "ardupilot"]
BOARD = "01" + "00" * 17
"""The simulated board's number: its system id, and zeros."""

CHANGED = {"px4": "COM_LOW_BAT_ACT", "ardupilot": "BATT_FS_LOW_ACT"}
STAYS_ARMED = {"px4": {"COM_DISARM_PRFLT": -1.0}, "ardupilot": {"DISARM_DELAY": 0.0}}


@dataclass
class Restored:
    """State after `companion restore`."""

    code: int
    said: str
    value: float


@pytest.fixture
def restore(tmp_path):
    """Return `restore(autopilot, own=, now=)`: the command with a vehicle on the ground."""

    def run(autopilot_kind: str, *, now: float, armed: bool = False) -> Restored:
        name = CHANGED[autopilot_kind]
        settings = {name: now} | STAYS_ARMED[autopilot_kind]
        served = on_the_ground(autopilot_kind, settings)

        def arm_once_home_is_set(served: VehicleHost) -> None:
            while not served.autopilot.state.home_is_set:
                time.sleep(0.01)
            served.autopilot.state.is_armed = armed

        words = ("restore", f"--vehicle-settings={tmp_path}")
        done = companion_done(served, *words, prepare=arm_once_home_is_set)
        return Restored(done.returncode, done.stdout, served.autopilot.params[name])

    return run


def kept(tmp_path: Path, autopilot_kind: str) -> Path:
    return tmp_path / f"{autopilot_kind}-1-{BOARD}.json"


@pytest.mark.sample
@pytest.mark.drawn
@pytest.mark.parametrize("autopilot_kind", BOTH)
def test_a_companion_killed_for_good_leaves_on_record_what_the_vehicle_had(
    fly_case, autopilot_kind
):
    dies = {"kind": "companion_kill", "phase": "outbound", "at_s": 4.0, "restart": False}
    flown = fly_case(autopilot_kind, {"faults": [dies]})
    own = read_parameters(PARAMS / "autopilots" / f"{autopilot_kind}.toml", {})
    now = flown.craft.autopilot.params
    left = read_original_parameters(kept(flown.craft.run_dir / "vehicle_settings", autopilot_kind))
    assert left == {name: pytest.approx(own[name].value) for name in left}
    assert CHANGED[autopilot_kind] in left
    assert all(now[name] != value for name, value in left.items())


@pytest.mark.sample
@pytest.mark.drawn
@pytest.mark.parametrize("autopilot_kind", BOTH)
def test_after_a_whole_flight_nothing_is_left(fly_case, autopilot_kind):
    flown = fly_case(autopilot_kind)
    assert (
        f"setting {CHANGED[autopilot_kind]}: "
        in (flown.craft.run_dir / "companion.log").read_text()
    )
    assert not kept(flown.craft.run_dir / "vehicle_settings", autopilot_kind).exists()


@pytest.mark.sample
@pytest.mark.drawn
@pytest.mark.parametrize("autopilot_kind", BOTH)
def test_restore_puts_them_back_and_forgets_them(restore, tmp_path, autopilot_kind):
    write_or_remove_original_parameters(
        kept(tmp_path, autopilot_kind), {CHANGED[autopilot_kind]: 1.0}
    )
    restored = restore(autopilot_kind, now=2.0)
    assert restored.code == 0, restored.said
    assert restored.value == 1.0
    assert f"ok       {CHANGED[autopilot_kind]}: 2 -> 1" in restored.said
    assert not kept(tmp_path, autopilot_kind).exists()


@pytest.mark.sample
@pytest.mark.drawn
@pytest.mark.parametrize("autopilot_kind", BOTH)
def test_safety_rule_1_restore_sets_nothing_on_an_armed_vehicle(restore, tmp_path, autopilot_kind):
    write_or_remove_original_parameters(
        kept(tmp_path, autopilot_kind), {CHANGED[autopilot_kind]: 1.0}
    )
    restored = restore(autopilot_kind, now=2.0, armed=True)
    assert restored.code == 3, restored.said
    assert restored.value == 2.0
    assert "the vehicle is armed" in restored.said
    assert kept(tmp_path, autopilot_kind).exists()


@pytest.mark.sample
def test_restore_without_anything_left_says_so(restore):
    restored = restore("px4", now=2.0)
    assert restored.code == 0
    assert restored.value == 2.0
    assert "nothing to restore" in restored.said
