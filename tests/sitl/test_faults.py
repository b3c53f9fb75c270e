"""Rows of the standing suite, drawn; and each guard taken out, so that its row breaks.

A guard is taken out by a patch of this test's in the companion's process, before its `main` runs:
the companion has no switch for it.
"""

import pytest

from sim_bridge.app.fault_suite.catalogue import CATALOGUE
from sim_bridge.app.fault_suite.suite import fly_fault, tasks
from sim_bridge.app.faults.case import BOTH, PHASES
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.flight import companion_process

pytestmark = pytest.mark.sitl


def without(module: str, name: str, value: str) -> str:
    """A patch of the companion's process: this name of this module does nothing but this."""
    return f"import {module} as guarded; guarded.{name} = lambda *given, **named: {value}"


NO_DISK_GUARD = """\
import companion.adapters.files.disk as guarded
class Unguarded:
    def __init__(self, on_trouble, **named): pass
    def do(self, record, deed, **named): deed()
    def settle(self): pass
    def close(self): pass
guarded.DiskThread = guarded.DiskAtOnce = Unguarded
"""

AUTHORITY = "companion.core.pilot.authority"
HOLD = "companion.core.pilot.unanswered_hold"

BLIND = f"""\
{without(AUTHORITY, "Authority.on_event", "None")}
import dataclasses, companion.core.pilot.mission_progress as progress
follow = progress.MissionFollower._follow
def unwary(self, context, event):
    return follow(self, context, dataclasses.replace(event, in_mission=None))
progress.MissionFollower._follow = unwary
"""
"""Neither the mode nor the mission's state show anybody's hand."""

GUARDS: dict[str, tuple[str, str]] = {
    "shorter-upload": (
        "return",
        without("companion.core.pilot.mission_progress", "MissionFollower.stands_still", "False"),
    ),
    "arm-ack-lost": (
        "ready",
        without(AUTHORITY, "Authority._is_foreign_disarm", "False"),
    ),
    "kill-switch": ("outbound", BLIND),
    "acks-lost": ("outbound", BLIND),
    "false-disarmed": (
        "outbound",
        without(AUTHORITY, "Authority._is_foreign_disarm", "False")
        + "\nimport companion.core.pilot.landing as landing; landing.DISARMED_S = 0.0"
        + "\nimport companion.core.pilot.telemetry_state as said; said.DISARMED_WITNESSES = 1\n"
        + without("companion.core.pilot.context", "FlightContext.against_standing", "''"),
    ),
    "same-length-edit": (
        "outbound",
        without("companion.core.pilot.mission_aboard", "MissionAboard._doubt", "None"),
    ),
    "foreign-upload": (
        "return",
        without("companion.core.pilot.mission_aboard", "MissionAboard._doubt", "None"),
    ),
    "fence-changed": ("outbound", without(HOLD, "UnansweredHold._failsafe", "None")),
    "home-down-20": (
        "outbound",
        without("companion.core.pilot.home_watch", "HomeWatch._watch", "None"),
    ),
    "draw-2": (
        "outbound",
        without("companion.core.vehicle.draw_change", "DrawChange.observe", "None"),
    ),
    "counter-wild": (
        "outbound",
        without("companion.core.vehicle.battery_gauge", "_reach_wh", "1e9")
        + "\n"
        + without("companion.core.vehicle.energy_ledger", "EnergyLedger._least_possible_wh", "0.0"),
    ),
    "percentage-0-once": (
        "outbound",
        without("companion.core.vehicle.battery_gauge", "_reach_wh", "1e9")
        + "\n"
        + without("companion.core.vehicle.energy_ledger", "EnergyLedger._least_possible_wh", "0.0"),
    ),
    "disk-full": ("outbound", NO_DISK_GUARD),
    "reboot-on-the-ground": (
        "ready",
        without("companion.core.pilot.ground_sequence", "GroundSequence._has_stopped", "False")
        + "\n"
        + "import companion.core.pilot.authority as authority\n"
        "from companion.core.mission.events import ClockStepped\n"
        "authority.ClockStepped = type('Never', (), {})\n"
        "import companion.adapters.clock as clock\n"
        "clock._Source.laid = lambda self, stamp_s, core_s: stamp_s + self.offset_s",
    ),
    "parcel-sticks": (
        "drop",
        "import companion.core.pilot.parcel_release as guarded\n"
        "guarded.ReleaseWatch.evidence = lambda self, t_s: 'the gripper says so'",
    ),
    "second-takes-over": ("outbound", without(AUTHORITY, "Authority._is_theirs", "False")),
    "payload-computer-flies": ("return", without(AUTHORITY, "Authority._is_theirs", "False")),
    "replayed-frames": (
        "return",
        "import hashlib, companion.adapters.autopilots.codec as guarded\n"
        "def unwary(self, frame, system, component):\n"
        "    right = hashlib.sha256(bytes(self.signing.secret_key) + bytes(frame[:-6])).digest()\n"
        "    return right[:6] == bytes(frame[-6:])\n"
        "guarded._Codec.check_signature = unwary",
    ),
    "mission-cleared": ("return", without(HOLD, "UnansweredHold.tick", "None")),
}
"""By row: the phase, and the patch that takes its guard out."""

BY_ARDUPILOT = {"shorter-upload", "reboot-on-the-ground"}
"""Guards that matter on ArduPilot only; of all others PX4 is shown."""

ROWS = [
    (task.fault, task.autopilot, task.phase) for task in tasks(CATALOGUE, BOTH, PHASES, [1], None)
]


def flown(tmp_path, fault: str, autopilot: str, phase: str, seed: int = 1) -> FaultRow:
    return fly_fault(FaultTask(fault, autopilot, phase, seed, tmp_path))


@pytest.mark.drawn(keep=5)  # by night every row by both autopilots in every phase
@pytest.mark.parametrize(("fault", "autopilot", "phase"), ROWS)
def test_a_fault_costs_no_vehicle(tmp_path, fault, autopilot, phase):
    row = flown(tmp_path, fault, autopilot, phase)
    assert row.held, (row.why, row.said)


@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("fault", GUARDS)
def test_without_its_guard_the_row_breaks(tmp_path, monkeypatch, fault):
    phase, patch = GUARDS[fault]
    monkeypatch.setattr(companion_process, "ENTRY", f"{patch}\n{companion_process.ENTRY}")
    autopilot = "ardupilot" if fault in BY_ARDUPILOT else "px4"
    assert not flown(tmp_path, fault, autopilot, phase).held
