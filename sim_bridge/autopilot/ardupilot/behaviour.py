"""Simulated ArduCopter (4.7-dev), constructed from its components."""

import math

from sim_bridge.autopilot.ardupilot.checks import PREARM_OK_AFTER_S, ArduPilotChecks
from sim_bridge.autopilot.ardupilot.commands import ArduPilotCommands
from sim_bridge.autopilot.ardupilot.failsafe import ArduPilotFailsafe
from sim_bridge.autopilot.ardupilot.guided import ArduPilotGuided
from sim_bridge.autopilot.ardupilot.mission import ArduPilotMission
from sim_bridge.autopilot.ardupilot.mission_items import ARDUPILOT_MISSION
from sim_bridge.autopilot.ardupilot.mode_numbers import MODES, NAMES
from sim_bridge.autopilot.ardupilot.modes import ArduPilotModes
from sim_bridge.autopilot.ardupilot.payload import ArduPilotPayload
from sim_bridge.autopilot.ardupilot.rules import ArduPilotRules
from sim_bridge.autopilot.ardupilot.telemetry import (
    ArduPilotLinkPolicy,
    ArduPilotTelemetry,
    message_names_of_stream_group,
)
from sim_bridge.autopilot.base.goals import Goal, Idle, Setpoint
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.behaviour import AutopilotParts
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, MavResult, Severity
from sim_bridge.autopilot.mavlink.router import ArduPilotRouter
from sim_bridge.autopilot.mission.items import MissionItem
from sim_bridge.autopilot.services.commands import CommonCommands, Firmware
from sim_bridge.autopilot.state import RADIO, EstimatorTiming

_SWITCH_EDGES_US = (1230, 1360, 1490, 1620, 1749)
_FIRMWARE = Firmware(
    version=0x04070000,
    git_hash=b"90700977",
    capabilities=(
        1 | 2 | 4 | 8 | 64 | 128 | 256 | 512 | 2048 | 4096 | 8192 | 16384 | 32768 | 131072
    ),
    refused_interval=MavResult.DENIED,
    refused_request=MavResult.FAILED,
)


class ArduPilot:
    """Implements `AutopilotBehaviour` and `CommanderHooks` as ArduCopter does."""

    rules = ArduPilotRules()
    mission_rules = ARDUPILOT_MISSION
    habits = ArduPilotLinkPolicy()
    router = ArduPilotRouter
    timing = EstimatorTiming(ready_after_s=42.0, gnss_timeout_s=10.0)
    landing_lean_limit_rad: float | None = math.radians(7.0)
    responds_to_ping = False

    def __init__(self, parts: AutopilotParts) -> None:
        state, radio, guidance, rc = parts.state, parts.radio, parts.guidance, parts.rc
        self._state = state
        self._radio = radio
        self._guidance = guidance
        self._rc = rc
        self.commander = Commander(state, parts.landing, self)
        self._targets = ModeTargets(guidance)
        self._payload = ArduPilotPayload(state, radio)
        guided = ArduPilotGuided(state, guidance, self._targets, self.rules)
        self.mission = ArduPilotMission(
            state,
            parts.store,
            radio,
            self.commander,
            guidance,
            self._targets,
            rc,
            self._payload,
            guided,
            self.rules,
        )
        self.executor = self.mission.executor
        self._checks = ArduPilotChecks(
            state, radio, rc, parts.battery, parts.store, self.executor.plan
        )
        self._modes = ArduPilotModes(state, self.commander, self._targets, rc, self.mission, guided)
        self._failsafe = ArduPilotFailsafe(
            state, radio, self.commander, rc, parts.battery, parts.geofence
        )
        self._telemetry = ArduPilotTelemetry(
            state, self.executor, parts.battery, parts.wind, rc, self._targets, self._checks
        )
        self.streams = self._telemetry.streams
        self._commands = ArduPilotCommands(
            state,
            radio,
            self.commander,
            self._checks,
            self.mission,
            self._modes,
            guided,
            self._payload,
            self.streams,
            CommonCommands(state, radio, self.commander, self.streams, self.habits, _FIRMWARE),
            parts.reboot,
        )
        self.commands = self._commands.handlers
        self._switch: int | None = None
        self._switch_candidate: int | None = None
        self._prearm_reported_s = 0.0

    @property
    def is_gripper_open(self) -> bool:
        """Return True if the gripper is open."""
        return self._payload.release

    # --- flying -------------------------------------------------------------------------------

    def initial_mode(self) -> Mode:
        """INITIAL_MODE: STABILIZE."""
        return MODES.get(int(self._state.params["INITIAL_MODE"]), Mode.STABILIZE)

    def advance_mode_and_return_goal(self) -> Goal:
        """Return the goal of the current mode."""
        return self._modes.update_and_return_goal()

    def update_remaining_battery_frac(self) -> float | None:
        """Remaining battery charge."""
        return self._telemetry.remaining_frac()

    def reset_at_reboot(self, *, in_flight: bool) -> None:
        """Reset the volatile state at a reboot."""
        self._guidance.speed_override_mps = None
        self._targets.clear_except_setpoint()
        self._targets.setpoint = None
        self._failsafe.reset_latches()
        if in_flight:
            return
        self._payload.release = False
        self.executor.deactivate_keeping_item()
        self.executor.reset_to_first_item()

    def run_10hz_tasks(self) -> None:
        """Run the 10 Hz tasks, in ArduCopter's order."""
        state = self._state
        self._change_mode_by_steady_rc_switch()
        if state.is_armed:
            self._failsafe.check_and_trigger_failsafes()
        if not state.is_landed:
            self.commander.record_takeoff()
            self.mission.allow_takeoff_without_throttle()
        self._payload.report_finished_grip()
        if state.is_armed:
            self._disarm_if_idle_after_delay()
        else:
            self._report_prearm_problem_every_30_s()

    def _disarm_if_idle_after_delay(self) -> None:
        """DISARM_DELAY after landing or arming, with nothing to do and the throttle down."""
        state = self._state
        delay = state.params["DISARM_DELAY"]
        idle_s = state.t_s - max(state.armed_since_s, state.landed_since_s)
        if not state.is_landed or delay <= 0.0 or idle_s < delay:
            return
        sticks = self._rc.stick_positions()
        if isinstance(state.goal, Idle) and (sticks is None or sticks.throttle < 0.1):
            self.commander.disarm()

    def _report_prearm_problem_every_30_s(self) -> None:
        """Report the findings of the pre-arm checks every 30 s."""
        state = self._state
        if state.t_since_boot_s <= PREARM_OK_AFTER_S or state.t_s - self._prearm_reported_s <= 30.0:
            return
        self._prearm_reported_s = state.t_s
        problem = self._checks.prearm_problem()
        if problem is not None:
            self._radio.send_status_text(Severity.CRITICAL, f"PreArm: {problem}")

    # --- commander's hooks --------------------------------------------------------------------

    def on_mode_exit(self, mode: Mode) -> None:
        """End the activity of the mode that is left."""
        if mode is Mode.AUTO:
            self.executor.deactivate_keeping_item()
        self._targets.returning = None
        self._guidance.fixed_yaw_rad = None

    def on_mode_entry(self, mode: Mode) -> None:
        """Start the activity of the new mode."""
        self._targets.clear_except_setpoint()
        if mode in (Mode.AUTO, Mode.GUIDED, Mode.RTL):
            self._guidance.speed_override_mps = None
            self._guidance.set_limits(self.rules.controller_limits(self._state.params))
        self._modes.initialise_entered_mode(mode)
        # mode.cpp, set_mode: sent at once, not with the next second's
        self._radio.send_on_all_links("HEARTBEAT", **(self.streams["HEARTBEAT"]() or {}))

    def on_armed(self) -> None:
        """Handle arming: in AUTO it starts the mission."""
        self._targets.hold_point = None
        self.mission.require_throttle_for_takeoff()
        if self._state.mode is Mode.AUTO:
            self.executor.activate_at_current_item()
        self._radio.send_status_text(Severity.INFO, "Arming motors")

    def on_disarmed(self) -> None:
        """Disarming resets the mission."""
        self._targets.setpoint = None
        self.mission.require_throttle_for_takeoff()
        self.executor.deactivate_keeping_item()
        self.executor.reset_to_first_item()
        self._targets.takeoff_down_m = None
        self._radio.send_status_text(Severity.INFO, "Disarming motors")

    def on_home_changed(self) -> None:
        """Send the new home to all links."""
        for name in ("HOME_POSITION", "GPS_GLOBAL_ORIGIN"):
            fields = self.streams[name]()
            if fields is not None:
                self._radio.send_on_all_links(name, **fields)

    # --- radio control ------------------------------------------------------------------------

    def on_rc_override(self, sender_system_id: int, channel_pulses_us: list[int]) -> None:
        """Only from the ground station that SYSID_MYGCS names, for RC_OVERRIDE_TIME."""
        if self._failsafe.is_own_gcs(sender_system_id):
            hold_s = self._state.params["RC_OVERRIDE_TIME"]
            until_s = self._state.t_s + (hold_s if hold_s >= 0.0 else math.inf)
            self._rc.store_channel_overrides(channel_pulses_us, until_s)

    def _change_mode_by_steady_rc_switch(self) -> None:
        """A mode switch that has moved and is steady changes the mode."""
        params = self._state.params
        position = self._rc.switch_position(int(params["FLTMODE_CH"]), _SWITCH_EDGES_US)
        if position is None:
            return
        settled = position == self._switch_candidate
        self._switch_candidate = position
        if not settled or position == self._switch:
            return
        self._switch = position
        mode = MODES.get(int(params[f"FLTMODE{position + 1}"]))
        if mode is None:
            return
        problem = self._checks.mode_entry_problem(mode)
        if problem is None:
            self.commander.set_mode(mode, RADIO)
        else:
            self._radio.send_status_text(
                Severity.WARNING, f"Mode change to {NAMES[mode]} failed: {problem}"
            )

    # --- messages -----------------------------------------------------------------------------

    def on_gcs_heartbeat(self, gcs_system_id: int) -> None:
        """A ground station's HEARTBEAT has arrived."""
        self._failsafe.record_own_gcs_heartbeat(gcs_system_id)

    def on_setpoint(self, setpoint: Setpoint) -> None:
        """Accept a set-point only in GUIDED, or during a guided mission item."""
        self._modes.accept_setpoint_if_guided(setpoint)

    def handle_set_mode_message(self, link_id: int, message: Message) -> None:
        """SET_MODE: done or not done, and not acknowledged."""
        if message.base_mode & 1:
            sender = message.src_system, message.src_component
            self._commands.change_mode_by_number_if_allowed(message.custom_mode, sender)

    def on_mission_set_current(self, link_id: int, seq: int) -> None:
        """Handle MISSION_SET_CURRENT: the response repeats the requested number."""
        if self.executor.jump_to_item(seq):
            fields = self.streams["MISSION_CURRENT"]() or {}
            self._radio.send(link_id, "MISSION_CURRENT", **{**fields, "seq": seq})

    def try_fly_to_guided_mission_item(self, link_id: int, message: Message) -> bool:
        """A mission item with current = 2: fly there, in GUIDED."""
        is_accepted = self._state.mode is Mode.GUIDED and self._accept_item_position_as_setpoint(
            message
        )
        self._radio.send(
            link_id,
            "MISSION_ACK",
            target_system=message.src_system,
            target_component=message.src_component,
            type=0 if is_accepted else 1,
            mission_type=0,
        )
        return True

    def _accept_item_position_as_setpoint(self, message: Message) -> bool:
        """Use an item's position as a set-point; return False if it has none."""
        scale = 1.0 if message.msg_name == "MISSION_ITEM_INT" else 1e7
        x, y = message.x * scale, message.y * scale
        if not all(math.isfinite(number) for number in (x, y, message.z)):
            return False
        stored_item = self.mission_rules.validate_item(
            MissionItem(Cmd.NAV_WAYPOINT, message.frame, x=round(x), y=round(y), z=message.z), 0
        )
        if not isinstance(stored_item, MissionItem):
            return False
        position_ned_m = self.mission.item_position_ned_m(stored_item)
        self._modes.accept_setpoint_if_guided(
            Setpoint(self._state.t_s, position_ned_m, None, None, 0.0)
        )
        return True

    def message_names_of_stream_group(self, stream_group_id: int) -> tuple[str, ...]:
        """REQUEST_DATA_STREAM's groups."""
        return message_names_of_stream_group(stream_group_id)

    def handle_param_set_and_respond(self, link_id: int, message: Message) -> None:
        """Set a parameter: cast any type, ignore non-finite values, do not respond to unknown
        names."""
        params, name = self._state.params, message.param_id
        if name in params and params.store_wire_value_if_accepted(
            name, message.param_value, message.param_type
        ):
            for link in self._radio.links:
                self._radio.send_parameter(link, name, 65535)

    def param_value_response_index(self, requested_index: int) -> int | None:
        """The requested index; 65535 for a name."""
        return requested_index if requested_index >= 0 else 65535

    def handle_unknown_parameter_request(self, link_id: int, message: Message) -> None:
        """Send no response."""
