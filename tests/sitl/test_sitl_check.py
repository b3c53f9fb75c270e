"""`companion check`, and a refused run, started as a user does: over UDP, with either autopilot."""

import json
import math
import subprocess
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest

from companion.core.base.geo import LocalFrame
from tests.sitl.served import COMMAND, companion_done, on_the_ground

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(120)]

PARAMS = Path(__file__).parents[2] / "params"

AS_PROMISED = {
    "px4": {
        "COM_LOW_BAT_ACT": 3.0,
        "COM_RCL_EXCEPT": 1.0,
        "MPC_XY_VEL_MAX": 20.0,
        "MPC_TILTMAX_AIR": 35.0,
    },
    "ardupilot": {
        "AUTO_OPTIONS": 3.0,
        "FS_OPTIONS": 17.0,
        "BATT_FS_LOW_ACT": 2.0,
        "BATT_LOW_VOLT": 20.1,
        "GRIP_ENABLE": 1.0,
        "ANGLE_MAX": 3500.0,
    },
}
"""Settings of an owner who has followed the check's list once."""

LOW_BATTERY = {"px4": "COM_LOW_BAT_ACT", "ardupilot": "BATT_FS_LOW_ACT"}


@dataclass
class Checked:
    """State after the command; settings as the digest of all parameters, and the mission items."""

    code: int
    said: str
    settings_before: int
    settings_after: int
    armed: bool
    aboard: int


@pytest.fixture
def check(tmp_path, short_flight):
    """Return `check(autopilot, settings, ...)`, which runs the command or `words` with a vehicle on
    the ground.
    """

    def run(
        autopilot_kind: str,
        settings: dict[str, float],
        *,
        charge_frac: float = 0.9,
        armed: bool = False,
        words: tuple[str, ...] = ("check",),
        **changes: dict,
    ) -> Checked:
        served = on_the_ground(autopilot_kind, settings, charge_frac=charge_frac)
        mission = tmp_path / "flight.toml"
        mission.write_bytes(msgspec.toml.encode(short_flight(changes)))
        before = served.autopilot.params.checksum()
        served.autopilot.state.is_armed = armed
        paths = (f"--mission={mission}", f"--run-dir={tmp_path / 'run'}")
        done = companion_done(served, *words, *paths)
        return Checked(
            done.returncode,
            done.stdout,
            before,
            served.autopilot.params.checksum(),
            served.autopilot.is_armed,
            len(served.autopilot.store.mission),
        )

    return run


@pytest.mark.sample
@pytest.mark.drawn(of="autopilot_kind")
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_a_vehicle_set_up_as_the_promise_needs_it_is_ready(check, autopilot_kind):
    checked = check(autopilot_kind, AS_PROMISED[autopilot_kind])
    assert checked.code == 0, checked.said
    lines = checked.said.splitlines()
    assert lines[-1] == "READY"
    assert not any(line.startswith(("MISSING", "WAITING")) for line in lines), checked.said
    assert any(line.startswith("WARNING  no ground station or desk reaches") for line in lines)
    assert any(line.startswith("ok       battery: ") for line in lines)
    assert any(line.startswith("ok       route: 5 waypoints out") for line in lines)


@pytest.mark.sample
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_safety_rule_1_a_check_sets_nothing_and_arms_nothing(check, autopilot_kind):
    checked = check(autopilot_kind, {})
    assert checked.settings_after == checked.settings_before
    assert not checked.armed


@pytest.mark.sample
@pytest.mark.drawn(of="autopilot_kind")
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_a_failsafe_that_is_not_set_is_named_with_what_to_set(check, autopilot_kind):
    name = LOW_BATTERY[autopilot_kind]
    checked = check(autopilot_kind, AS_PROMISED[autopilot_kind] | {name: 0.0})
    assert checked.code == 3
    (missing,) = [line for line in checked.said.splitlines() if line.startswith("MISSING")]
    wanted = AS_PROMISED[autopilot_kind][name]
    assert missing == (
        f"MISSING  a low-battery action of the autopilot: {name} is 0, set {wanted:g}"
    )
    assert checked.said.splitlines()[-1] == "NOT READY"


RTL_HEIGHT = {"px4": "RTL_RETURN_ALT is 60", "ardupilot": "RTL_ALT is 1500"}


@pytest.mark.sample
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_a_no_fly_area_on_the_straight_line_home_is_named(check, autopilot_kind, tmp_path):
    frame = LocalFrame(math.radians(55.47), math.radians(8.45), 12.0)
    corners = [(-50.0, -230.0), (-50.0, -190.0), (0.0, -190.0), (0.0, -230.0), (-50.0, -230.0)]
    ring = [frame.to_geodetic((*corner, 0.0))[:2] for corner in corners]
    geometry = {
        "type": "Polygon",
        "coordinates": [[[math.degrees(lon), math.degrees(lat)] for lat, lon in ring]],
    }
    feature = {"type": "Feature", "properties": {"no_fly": True}, "geometry": geometry}
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    checked = check(autopilot_kind, AS_PROMISED[autopilot_kind], site={"obstacles": str(area)})
    assert checked.code == 3
    (missing,) = [line for line in checked.said.splitlines() if line.startswith("MISSING")]
    assert missing.startswith("MISSING  an RTL around no-fly areas: ")
    assert missing.endswith(RTL_HEIGHT[autopilot_kind])


STAYS_ARMED = {"px4": {"COM_DISARM_PRFLT": -1.0}, "ardupilot": {"DISARM_DELAY": 0.0}}


@pytest.mark.sample
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_safety_rule_1_a_check_of_an_armed_vehicle_says_so_and_ends(check, autopilot_kind):
    checked = check(autopilot_kind, STAYS_ARMED[autopilot_kind], armed=True)
    assert checked.code == 3
    missing, verdict = checked.said.splitlines()[-2:]
    assert missing.startswith("MISSING  the vehicle is armed in ")
    assert verdict == "NOT READY"
    assert checked.armed  # left unchanged
    assert checked.settings_after == checked.settings_before


@pytest.mark.sample
def test_an_empty_battery_is_called_empty(check):
    checked = check("px4", AS_PROMISED["px4"], charge_frac=0.03)  # 20.0 V by the world's table
    assert checked.code == 3
    assert "MISSING  the battery is empty: " in checked.said


@pytest.mark.sample
def test_a_pack_of_other_cells_than_the_airframes_is_named(check, tmp_path):
    # Six cells are fitted; the airframe's file states four.
    airframe = tmp_path / "four_cells.toml"
    text = (PARAMS / "airframes" / "m100.toml").read_text()
    airframe.write_text(text.replace("cells = 6", "cells = 4"))
    checked = check("ardupilot", {}, vehicle={"airframe": str(airframe)})
    assert checked.code == 3
    assert "does not fit a pack of 4 cells" in checked.said
    assert checked.settings_after == checked.settings_before


@pytest.mark.sample
def test_nobody_on_the_link_is_said_and_has_a_code_of_its_own(tmp_path, short_flight):
    mission = tmp_path / "flight.toml"
    mission.write_bytes(msgspec.toml.encode(short_flight({})))
    done = subprocess.run(
        [
            str(COMMAND),
            "check",
            "--link=udpout:127.0.0.1:9",
            f"--mission={mission}",
            f"--run-dir={tmp_path / 'run'}",
            "--silence-limit=1",
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 4
    assert (
        "no answer from an autopilot on udpout:127.0.0.1:9 (the autopilot must listen"
        in done.stdout
    )


@pytest.mark.sample
@pytest.mark.drawn(of="autopilot_kind")
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_a_mission_that_is_refused_is_taken_off_the_vehicle(check, autopilot_kind):
    refused = check(autopilot_kind, {}, words=("run", "--authorise"))
    assert "read back -> ready" in refused.said
    assert refused.aboard == 0
    assert not refused.armed
