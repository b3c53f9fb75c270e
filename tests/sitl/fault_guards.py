"""Guards of the companion that rows of the fault suite depend on, and the patch that disables each.

A guard is disabled by a patch in the companion's process before its `main` runs: the companion has
no switch for it.
"""

from importlib import import_module
from operator import attrgetter
from typing import NamedTuple


class Guard(NamedTuple):
    """Conditions in which a row fails without its guard: phase, patch and autopilot."""

    phase: str
    patch: str
    autopilot: str = "px4"


GROUND = "companion.core.pilot.ground"


def without(module: str, name: str, value: str) -> str:
    """Return a patch of the companion's process that replaces this function by a constant."""
    attrgetter(name)(import_module(module))  # an unknown name would leave the guard in place
    return (
        f"import functools, {module} as guarded; guarded.{name} ="
        f" functools.wraps(guarded.{name})(lambda *given, **named: {value})"  # same signature
    )


AUTHORITY = "companion.core.pilot.authority"
HOLD = "companion.core.pilot.control.unanswered_hold"

NO_DISK_GUARD = """\
import companion.adapters.files.disk as guarded
class Unguarded:
    def __init__(self, on_error, **named): pass
    def submit_write_job(self, record, job, **named): return job() or True
    def wait_until_done(self): pass
    def close(self): pass
guarded.ThreadedRecordWriter = guarded.ImmediateRecordWriter = Unguarded
"""

BLIND = f"""\
{without(AUTHORITY, "ControlAuthority._release_control_on_takeover", "None")}
import dataclasses, companion.core.pilot.mission_progress as progress
follow = progress.MissionProgressMonitor._update_from_progress
def unwary(self, context, event):
    return follow(self, context, dataclasses.replace(event, in_mission=None))
progress.MissionProgressMonitor._update_from_progress = unwary
"""
"""Neither the mode nor the mission state shows a pilot override."""

BELIEVES_AT_ONCE = f"""\
{without("companion.core.vehicle.battery_gauge", "_max_consumption_wh", "1e9")}
{
    without(
        "companion.core.vehicle.energy_ledger",
        "EnergyLedger._update_slack_and_least_remaining_wh",
        "0.0",
    )
}
"""
"""A single battery reading is accepted at once."""

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
import companion.core.pilot.estimators.flight_energy as estimates
import companion.core.vehicle.battery_gauge as gauge
told_by = estimates._with_battery_message
estimates._with_battery_message = lambda *given: dataclasses.replace(
    told_by(*given), source="vehicle")
def hear(self, t_s, now_frac, full_wh, max_draw_w, has_started):
    if self.left_frac is None:
        self.left_frac = now_frac
    self.left_frac = max(self.left_frac - max(self.last_frac - now_frac, 0.0), 0.0)
    self.last_frac, self.t_s = now_frac, t_s
    return False
gauge.Percentage.update_and_report_replacement_at_start = hear
{
    without(
        "companion.core.vehicle.energy_ledger",
        "EnergyLedger._update_slack_and_least_remaining_wh",
        "0.0",
    )
}
"""
"""All packs count as one, and each fall between them counts as used energy."""

NOTHING_IS_OLD = """\
import companion.core.pilot.telemetry_state as guarded
guarded.TelemetryState.is_recent = lambda self, sample, max_age_s: sample is not None
"""

READS_THE_CLOCK = """\
import companion.adapters.autopilots.codec as guarded
pack = guarded.MavlinkCodec.pack
def unwary(self, message):
    self.mav.signing.timestamp = (guarded.unix_time_us() - guarded.SIGNING_EPOCH_US) // 10
    return pack(self, message)
guarded.MavlinkCodec.pack = unwary
"""
"""Each frame is signed by the current wall clock."""

TRUSTS_ITS_CHECKPOINT = """\
import companion.app.flight.loaded_flight as guarded
def unwary(self):
    return guarded.read_checkpoint(self.options.run_dir, self.digest), ""
guarded.LoadedFlight.read_checkpoint_or_error = unwary
"""

TRUSTS_ITS_LOG = """\
import dataclasses, companion.app.flight.run_files as guarded
read_log = guarded.read_mcap_rows
guarded.read_mcap_rows = lambda path: dataclasses.replace(read_log(path), error_text="")
"""

NEEDS_A_THREAD = """\
import threading, companion.app.flight.planning as guarded
def start_thread(self, find_plan):
    run = self._compute_and_queue_result
    threading.Thread(target=run, args=(find_plan,), name="plan", daemon=True).start()
guarded.PlanningExecutor._start_thread = start_thread
"""

TRUSTS_A_CLOCK_THAT_STOPS = """\
import time, companion.adapters.clock as guarded
guarded.wall_s = lambda: time.monotonic()
"""

ORDER_OF_EVENTS_IGNORED = """\
import companion.core.pilot.control.unanswered_hold as guarded
def unwary(self, context, event):
    times_s = self._state.hold_start_s, self._aboard.last_mismatch_s
    if all(context.seconds_since(t_s) <= guarded.MAX_CAUSE_DELAY_S for t_s in times_s):
        self._state.cause = guarded.LIST_CHANGED
guarded.UnansweredHold._record_list_cleared_cause = unwary
"""

GATE_OPEN = without(
    "companion.core.pilot.return_decision", "ReturnDecision._gate_closing_reason", "''"
)
LIST_TRUSTED = without(
    "companion.core.pilot.onboard_verification",
    "OnboardMissionVerifier._start_verification_if_flying",
    "None",
)
HOME_TRUSTED = without(
    "companion.core.pilot.home_watch", "HomeMonitor._report_and_restore_displaced_home", "None"
)
OBSERVED = "companion.core.pilot.observed_state"
MISSION_STATE_UNREAD = without(OBSERVED, "ObservedState._store_mission_state", "None")
NEVER_THEIRS = without(AUTHORITY, "ControlAuthority._other_has_control", "False")

TEN_CELLS_READ = """\
import companion.adapters.autopilots.telemetry as guarded
read = guarded._battery_events
def unwary(message, t_s):
    message.voltages_ext = [0] * len(message.voltages_ext)
    return read(message, t_s)
guarded._battery_events = unwary
"""

PACK = "companion.core.pilot.telemetry.pack_telemetry"
POSITION_STEPS_ACCEPTED = without(
    "companion.core.pilot.telemetry.position_watch", "PositionWatch.accepts_report", "True"
)
MOTION_STEPS_ACCEPTED = without(
    "companion.core.wind.step_watch", "ReportWatch.update_and_describe_steps", "()"
)

GUARDS: dict[str, Guard] = {
    "shorter-upload": Guard(
        "return",
        without(
            "companion.core.pilot.return_course",
            "ReturnCourseMonitor.update_and_check_stationary",
            "False",
        ),
        "ardupilot",
    ),
    "mission-paused": Guard("return", MISSION_STATE_UNREAD, "ardupilot"),
    "mission-complete-away": Guard("return", MISSION_STATE_UNREAD, "ardupilot"),
    "motors-stop-at-20-m": Guard(
        "land",
        without(OBSERVED, "ObservedState._update_fall", "None")
        + "\n"
        + without(AUTHORITY, "DisarmMonitor._update_and_check_external_disarm", "False"),
    ),
    "barometer-drifts": Guard(
        "outbound", without(OBSERVED, "ObservedState._update_height_difference", "None")
    ),
    "arm-ack-lost": Guard(
        "ready", without(AUTHORITY, "DisarmMonitor._update_and_check_external_disarm", "False")
    ),
    "kill-switch": Guard("outbound", BLIND),
    "acks-lost": Guard("outbound", BLIND),
    "taken-back-at-once": Guard("outbound", BLIND),
    "false-disarmed": Guard(
        "outbound",
        without(AUTHORITY, "DisarmMonitor._update_and_check_external_disarm", "False")
        + "\nimport companion.core.pilot.landing as landing; landing.DISARMED_CONFIRM_S = 0.0"
        + "\nimport companion.core.pilot.telemetry_state as said; said.MIN_DISARMED_REPORTS = 1\n"
        + without("companion.core.pilot.context", "FlightContext.in_air_evidence_text", "''"),
    ),
    "same-length-edit": Guard("outbound", LIST_TRUSTED),
    "foreign-upload": Guard("return", LIST_TRUSTED),
    "fence-changed": Guard(
        "outbound", without(HOLD, "UnansweredHold._record_failsafe_cause", "None")
    ),
    "mission-cleared": Guard("return", without(HOLD, "UnansweredHold.tick", "None")),
    "home-down-20": Guard("outbound", HOME_TRUSTED),
    "height-reset": Guard("outbound", HOME_TRUSTED),
    "progress-late": Guard(
        "outbound",
        "import dataclasses, companion.core.mission.jump_watch as guarded\n"
        "guarded.JUMP = dataclasses.replace(guarded.JUMP, interval_s=0.3, max_tries=1)\n"
        "guarded.UNREPORTED_TIMEOUT_S = 0.3",
    ),
    "draw-1.7-far": Guard("outbound", GATE_OPEN),
    "draw-2": Guard(
        "outbound",
        without(
            "companion.core.vehicle.draw_change",
            "DrawChangeDetector.update_and_detect_change",
            "None",
        ),
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
        "guarded._Reader.start_reader_thread = lambda self: self._thread.start()",
    ),
    "clock-steps-back": Guard("outbound", READS_THE_CLOCK),
    "reboot-on-the-ground": Guard(
        "ready",
        without(f"{GROUND}.ground_sequence", "GroundSequence._has_lost_streams", "False")
        + "\n"
        + "import companion.core.pilot.authority as authority\n"
        "from companion.core.mission.events import ClockSteppedBack\n"
        "authority.ClockSteppedBack = type('Never', (), {})\n"
        "import companion.adapters.clock as clock\n"
        "clock._TimeSource.convert_to_core_time_and_correct_offset = (\n"
        "    lambda self, stamp_s, core_s: stamp_s + self.offset_s)",
        "ardupilot",
    ),
    "plan-worker-hangs": Guard(
        "ready",
        "import companion.core.pilot.ground.flight_planning as guarded; guarded.PLAN_TIMEOUT_S ="
        " 1e9",
    ),
    "plan-worker-breaks": Guard(
        "ready",
        "import companion.app.flight.planning as guarded\n"
        "guarded.compute_plan_or_error = lambda find: (find.request_number, find.compute_plan())",
    ),
    "parcel-sticks": Guard(
        "drop",
        without(
            "companion.core.pilot.estimators.release_watch",
            "ReleaseMonitor.release_evidence_text",
            "'reported by the gripper'",
        ),
    ),
    "second-takes-over": Guard("outbound", NEVER_THEIRS),
    "payload-computer-flies": Guard("return", NEVER_THEIRS),
    "held-again": Guard(
        "outbound",
        "import companion.adapters.autopilots.commands as guarded\n"
        "guarded.PendingCommand.has_tries_left = property(lambda self: self.attempt_count < 4)",
    ),
    "item-selected": Guard(
        "outbound",
        "import dataclasses, math, companion.core.mission.jump_watch as guarded\n"
        "guarded.JUMP = dataclasses.replace(guarded.JUMP, interval_s=1.0)\n"
        "guarded.UNCHANGED_MAX_AGE_S = math.inf",
        "ardupilot",
    ),
    "replaced-while-held": Guard(
        "outbound",
        "import companion.core.pilot.control.resume as guarded\n"
        "begin = guarded.FlightResumption.request_state_for_resumption\n"
        "def unwary(self, context, why):\n"
        "    begin(self, context, why)\n"
        "    self._mission_matches = True\n"
        "guarded.FlightResumption.request_state_for_resumption = unwary",
    ),
    "replaced-while-dead": Guard(
        "return",
        without(
            AUTHORITY,
            "ControlAuthority._is_resumption_possible",
            "given[1].phase.name == 'SUSPENDED'",
        ),
    ),
    "replaced-when-ready": Guard(
        "ready",
        f"import {GROUND}.start_checks as checks; checks.VERIFICATION_VALIDITY_S = 1e9\n"
        + without(
            "companion.core.pilot.flight_state", "OnboardListState.is_unchanged_in_phase", "True"
        ),
    ),
    "last-resort-refused": Guard(
        "outbound", without("companion.core.pilot.control.last_resort", "LastResort.tick", "None")
    ),
    "held-until-low": Guard(
        "outbound",
        without("companion.core.pilot.control.return_alarm", "ReturnAlarm._evaluate_hold", "None"),
    ),
    "failsafe-during-diversion": Guard(
        "return",
        without(
            "companion.core.pilot.home_watch", "HomeMonitor._redirect_home_to_landing_site", "None"
        ),
    ),
    "hopeless-mission": Guard(
        "outbound",
        without("companion.core.return_budget.budget", "Gate._low_value_reason", "None"),
    ),
    "radio-not-forwarded": Guard(
        "ready",
        without(f"{GROUND}.start_checks", "PreflightChecks._no_operator_reason", "''"),
    ),
    "pilot-lands-after-rtl": Guard(
        "outbound",
        "import companion.core.pilot.authority as guarded\n"
        "checked = guarded.OrderedMode.unexpected_mode_reason\n"
        "def accepts_land(self, state, **options):\n"
        "    is_land = self.effective is guarded.Mode.RTL and state.mode is guarded.Mode.LAND\n"
        "    return None if is_land else checked(self, state, **options)\n"
        "guarded.OrderedMode.unexpected_mode_reason = accepts_land",
    ),
    "computer-suspends": Guard("outbound", TRUSTS_A_CLOCK_THAT_STOPS),
    "stray-result": Guard(
        "ready",
        "import companion.adapters.autopilots.mission_transfer as guarded\n"
        "guarded.OTHER_TRANSFER = ()\n"
        f"import {GROUND}.ground_sequence as sequence; sequence.MAX_UPLOADS = 1",
    ),
    "monitor-without-pack-full": Guard(
        "ready",
        without(PACK, "PackTelemetry._monitor_selection_key", "0")
        + "\n"
        + without(PACK, "PackTelemetry._is_about_pack", "True"),
    ),
    "slow-upload": Guard(
        "ready",
        "import companion.adapters.autopilots.mission_transfer as guarded; guarded.MAX_TRIES = 2",
    ),
    "slow-parameters": Guard(
        "ready",
        "import companion.adapters.autopilots.parameters as guarded; guarded.MAX_TRIES = 2\n"
        "import companion.adapters.autopilots.commands as commands\n"
        "commands.ResponseTime.response_timeout_s = property(lambda self: 0.0)",
    ),
    "current-sensor-low": Guard(
        "ready",
        without(
            "companion.core.vehicle.draw_change", "LowCurrentDetector.update_and_detect", "False"
        ),
    ),
    "many-cells": Guard("ready", TEN_CELLS_READ),
    "monitor-freezes": Guard("outbound", without(PACK, "FreezeDetector._is_frozen", "False")),
    "heading-step": Guard("outbound", MOTION_STEPS_ACCEPTED),
    "position-step": Guard("outbound", POSITION_STEPS_ACCEPTED),
    "altitude-step": Guard("outbound", POSITION_STEPS_ACCEPTED),
    "velocity-step": Guard("outbound", MOTION_STEPS_ACCEPTED),
    "hold-then-upload": Guard("outbound", ORDER_OF_EVENTS_IGNORED),
    "intruding-heartbeat": Guard(
        "outbound",
        without("companion.adapters.autopilots.port", "AutopilotPort.is_intruding_heartbeat", "0"),
    ),
    "strangers": Guard("outbound", HEARS_ANY_SYSTEM),
    "replayed-frames": Guard(
        "return",
        "import hashlib, companion.adapters.autopilots.codec as guarded\n"
        "def unwary(self, frame, system, component):\n"
        "    right = hashlib.sha256(bytes(self.signing.secret_key) + bytes(frame[:-6])).digest()\n"
        "    return right[:6] == bytes(frame[-6:])\n"
        "guarded._VerifyingCodec.check_signature = unwary",
    ),
}
"""By row. Only effects specific to ArduPilot are tested on it."""

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
    81: f"the row requires a return, and there is {LIST_ABOARD}; test_link.py asks each leap alone",
    84: "each disarm needs two of rest, detector and thrust: without one the others suffice;"
    " test_observed_state.py takes each away",
    59: "none: a plan is made anew, which is what a desk does all day",
}
"""By number: rows without a guard that a patch could disable."""

SAME_GUARD = {15: 16, 17: 16, 21: 23, 24: 22, 32: 22, 39: 22, 41: 40, 62: 60, 78: 22, 90: 30}
"""By number: the row whose guard also protects this row. For 24, 32, 39 and 78 it is the gate;
their flights are short enough to end at home without it. For 62 it is the store's constraint on two
desks; no other decision of desk or vehicle reads a foreign wall clock."""
