"""The guards of the companion that the standing suite's rows rest on, and how each is taken out.

A guard is taken out by a patch in the companion's process, before its `main` runs: the companion
has no switch for it.
"""

from typing import NamedTuple


class Guard(NamedTuple):
    """Where a row is shown to break: its phase, the patch, and the autopilot."""

    phase: str
    patch: str
    autopilot: str = "px4"


def without(module: str, name: str, value: str) -> str:
    """A patch of the companion's process: this name of this module does nothing but this."""
    return f"import {module} as guarded; guarded.{name} = lambda *given, **named: {value}"


AUTHORITY = "companion.core.pilot.authority"
HOLD = "companion.core.pilot.unanswered_hold"

NO_DISK_GUARD = """\
import companion.adapters.files.disk as guarded
class Unguarded:
    def __init__(self, on_trouble, **named): pass
    def do(self, record, deed, **named): deed()
    def settle(self): pass
    def close(self): pass
guarded.DiskThread = guarded.DiskAtOnce = Unguarded
"""

BLIND = f"""\
{without(AUTHORITY, "Authority.on_event", "None")}
import dataclasses, companion.core.pilot.mission_progress as progress
follow = progress.MissionFollower._follow
def unwary(self, context, event):
    return follow(self, context, dataclasses.replace(event, in_mission=None))
progress.MissionFollower._follow = unwary
"""
"""Neither the mode nor the mission's state show anybody's hand."""

BELIEVES_AT_ONCE = f"""\
{without("companion.core.vehicle.battery_gauge", "_reach_wh", "1e9")}
{without("companion.core.vehicle.energy_ledger", "EnergyLedger._least_possible_wh", "0.0")}
"""
"""One reading of a battery is a fact."""

HEARS_ANY_SYSTEM = """\
import companion.adapters.autopilots.port as guarded
hear = guarded.AutopilotPort.on_message
def unwary(self, message):
    if self.system_id is not None and message.get_srcComponent() == 1:
        message.get_header().srcSystem = self.system_id
    return hear(self, message)
guarded.AutopilotPort.on_message = unwary
"""

ONE_GAUGE = f"""\
import dataclasses
import companion.core.pilot.estimates as estimates
import companion.core.vehicle.battery_gauge as gauge
told_by = estimates._told_by
estimates._told_by = lambda *given: dataclasses.replace(told_by(*given), source="vehicle")
def hear(self, t_s, now_frac, full_wh, most_w, started):
    if self.left_frac is None:
        self.left_frac = now_frac
    self.left_frac = max(self.left_frac - max(self.last_frac - now_frac, 0.0), 0.0)
    self.last_frac, self.t_s = now_frac, t_s
    return False
gauge.Percentage.hear = hear
{without("companion.core.vehicle.energy_ledger", "EnergyLedger._least_possible_wh", "0.0")}
"""
"""All packs are one, and each fall from one to the next is used energy."""

NOTHING_IS_OLD = """\
import companion.core.pilot.telemetry_state as guarded
guarded.TelemetryState.is_fresh = lambda self, sample, max_age_s: sample is not None
"""

READS_THE_CLOCK = """\
import companion.adapters.autopilots.codec as guarded
pack = guarded.MavlinkCodec.pack
def unwary(self, message):
    self.mav.signing.timestamp = (guarded.epoch_us() - guarded.SIGNING_EPOCH_US) // 10
    return pack(self, message)
guarded.MavlinkCodec.pack = unwary
"""
"""Each frame is signed by the wall clock as it stands."""

TRUSTS_ITS_CHECKPOINT = """\
import companion.app.flight.loaded_flight as guarded
def unwary(self):
    return guarded.read_checkpoint(self.options.run_dir, self.digest), ""
guarded.LoadedFlight.kept = unwary
"""

TRUSTS_ITS_LOG = """\
import dataclasses, companion.app.flight.recorder as guarded
read_log = guarded.read_log
guarded.read_log = lambda path: dataclasses.replace(read_log(path), damage="")
"""

NEEDS_A_THREAD = """\
import threading, companion.app.flight.planning as guarded
def begin(self, asked):
    threading.Thread(target=self._work, args=(asked,), name="plan", daemon=True).start()
guarded.PlanBeside.begin = begin
"""

GATE_OPEN = without("companion.core.pilot.return_decision", "ReturnDecision._why_closed", "''")
LIST_TRUSTED = without("companion.core.pilot.mission_aboard", "MissionAboard._doubt", "None")
HOME_TRUSTED = without("companion.core.pilot.home_watch", "HomeWatch._watch", "None")
NEVER_THEIRS = without(AUTHORITY, "Authority._is_theirs", "False")

GUARDS: dict[str, Guard] = {
    "shorter-upload": Guard(
        "return",
        without("companion.core.pilot.mission_progress", "MissionFollower.stands_still", "False"),
        "ardupilot",
    ),
    "arm-ack-lost": Guard("ready", without(AUTHORITY, "Authority._is_foreign_disarm", "False")),
    "kill-switch": Guard("outbound", BLIND),
    "acks-lost": Guard("outbound", BLIND),
    "taken-back-at-once": Guard("outbound", BLIND),
    "false-disarmed": Guard(
        "outbound",
        without(AUTHORITY, "Authority._is_foreign_disarm", "False")
        + "\nimport companion.core.pilot.landing as landing; landing.DISARMED_S = 0.0"
        + "\nimport companion.core.pilot.telemetry_state as said; said.DISARMED_WITNESSES = 1\n"
        + without("companion.core.pilot.context", "FlightContext.against_standing", "''"),
    ),
    "same-length-edit": Guard("outbound", LIST_TRUSTED),
    "foreign-upload": Guard("return", LIST_TRUSTED),
    "fence-changed": Guard("outbound", without(HOLD, "UnansweredHold._failsafe", "None")),
    "mission-cleared": Guard("return", without(HOLD, "UnansweredHold.tick", "None")),
    "home-down-20": Guard("outbound", HOME_TRUSTED),
    "height-reset": Guard("outbound", HOME_TRUSTED),
    "progress-late": Guard(
        "outbound",
        "import companion.core.mission.jump_watch as guarded\n"
        "guarded.CONFIRM_S, guarded.TRIES = 0.3, 1",
    ),
    "draw-1.7-far": Guard("outbound", GATE_OPEN),
    "draw-2": Guard(
        "outbound", without("companion.core.vehicle.draw_change", "DrawChange.observe", "None")
    ),
    "packs-5-apart": Guard("ready", ONE_GAUGE),
    "counter-wild": Guard("outbound", BELIEVES_AT_ONCE),
    "percentage-0-once": Guard("outbound", BELIEVES_AT_ONCE),
    "position-off": Guard("outbound", NOTHING_IS_OLD),
    "attitude-off": Guard("outbound", NOTHING_IS_OLD),
    "disk-full": Guard("outbound", NO_DISK_GUARD),
    "torn-checkpoint": Guard("outbound", TRUSTS_ITS_CHECKPOINT),
    "torn-decision-log": Guard("outbound", TRUSTS_ITS_LOG),
    "no-threads": Guard("ready", NEEDS_A_THREAD),
    "back-without-a-thread": Guard(
        "outbound",
        "import companion.adapters.autopilots.link as guarded\n"
        "guarded._Reader.start = lambda self: self._thread.start()",
    ),
    "clock-steps-back": Guard("outbound", READS_THE_CLOCK),
    "reboot-on-the-ground": Guard(
        "ready",
        without("companion.core.pilot.ground_sequence", "GroundSequence._has_stopped", "False")
        + "\n"
        + "import companion.core.pilot.authority as authority\n"
        "from companion.core.mission.events import ClockStepped\n"
        "authority.ClockStepped = type('Never', (), {})\n"
        "import companion.adapters.clock as clock\n"
        "clock._Source.laid = lambda self, stamp_s, core_s: stamp_s + self.offset_s",
        "ardupilot",
    ),
    "plan-worker-hangs": Guard(
        "ready",
        "import companion.core.pilot.ground_sequence as guarded; guarded.PLAN_LIMIT_S = 1e9",
    ),
    "plan-worker-breaks": Guard(
        "ready",
        "import companion.app.flight.planning as guarded\n"
        "guarded.worked_out = lambda asked: (asked.number, asked.work())",
    ),
    "parcel-sticks": Guard(
        "drop",
        "import companion.core.pilot.parcel_release as guarded\n"
        "guarded.ReleaseWatch.evidence = lambda self, t_s: 'the gripper says so'",
    ),
    "second-takes-over": Guard("outbound", NEVER_THEIRS),
    "payload-computer-flies": Guard("return", NEVER_THEIRS),
    "held-again": Guard(
        "outbound",
        "import companion.adapters.autopilots.commands as guarded\n"
        "submit = guarded.CommandQueue.submit\n"
        "def unwary(self, lane, entry, t_s, **named):\n"
        "    entry.most_tries, entry.answer_s = 4, 1.0\n"
        "    submit(self, lane, entry, t_s, **named)\n"
        "guarded.CommandQueue.submit = unwary",
    ),
    "item-selected": Guard(
        "outbound",
        without("companion.adapters.autopilots.port", "AutopilotPort._watch_item", "None"),
        "ardupilot",
    ),
    "replaced-while-held": Guard(
        "outbound",
        "import companion.core.pilot.resume as guarded\n"
        "begin = guarded.Resume.begin\n"
        "def unwary(self, context, why):\n"
        "    begin(self, context, why)\n"
        "    self._mission_matches = True\n"
        "guarded.Resume.begin = unwary",
    ),
    "replaced-while-dead": Guard(
        "return",
        without(AUTHORITY, "Authority._may_take_back", "given[1].phase.name == 'SUSPENDED'"),
    ),
    "replaced-when-ready": Guard(
        "ready",
        without("companion.core.pilot.ground_sequence", "GroundSequence._is_ours_aboard", "True")
        + "\nguarded.VERIFIED_S = 1e9",
    ),
    "last-resort-refused": Guard("outbound", without(HOLD, "LastResort.tick", "None")),
    "strangers": Guard("outbound", HEARS_ANY_SYSTEM),
    "replayed-frames": Guard(
        "return",
        "import hashlib, companion.adapters.autopilots.codec as guarded\n"
        "def unwary(self, frame, system, component):\n"
        "    right = hashlib.sha256(bytes(self.signing.secret_key) + bytes(frame[:-6])).digest()\n"
        "    return right[:6] == bytes(frame[-6:])\n"
        "guarded._Codec.check_signature = unwary",
    ),
}
"""By row. Only what matters on ArduPilot alone is shown on it."""

LIST_ABOARD = "the mission aboard, which leads home from each of its items without the companion"
NO_GUARD = {
    3: "shown by `sim-bridge trials stall`, whose guard is taken out in test_trials.py",
    8: f"no name tells it from our vehicle: we let go, and there is {LIST_ABOARD}",
    14: "the autopilot's own: an upload that stops is dropped, and the list before it stays",
    28: "none: the voltage under load bounds what is believed, and the flight has that to spare",
    29: "none: as for a cold pack",
    31: "none: wind and draw are off by the density, and no flight is lost by that",
    33: "none: the wind is estimated where the vehicle is",
    34: "none: the estimator counts in the world's axes, whatever the heading",
    35: "none: the autopilot flies by these positions, too",
    38: "none: as for a spin; what is told of the course is by position",
    42: "a thread writes, and nobody waits for it: taken out, the row would take minutes of sleep;"
    " test_disk.py asks it of a disk that hangs, `research bench flight` of a slow one",
    47: "that of 3: what waited is heard before anything is decided",
    49: LIST_ABOARD,
    50: "none: orders are repeated until telemetry shows their effect, and few are needed",
    51: LIST_ABOARD,
    53: "many; `sim-bridge trials fuzz` asks each of them by itself",
    55: "none: what the radio loses is as in 50",
    59: "none: a plan is made anew, which is what a desk does all day",
}
"""By number: rows at which no guard of ours is at work that a patch could take out."""

SAME_GUARD = {15: 16, 17: 16, 21: 23, 24: 22, 32: 22, 39: 22, 41: 40, 62: 60}
"""By number: whose guard it is that holds this row, too. Of 24, 32 and 39 that is the gate; the
flight of those rows is short, so that without it they come home by luck. Of 62 it is what the store
allows two desks; beyond that no decision of desk or vehicle reads another's wall clock."""
