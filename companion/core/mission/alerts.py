"""All alerts that the companion reports to operators: one row per alert.

A row has an identifier, a severity, a text with parameters, and the recommended action. STATUSTEXT,
log, map, desk and the table in the documents are derived from it. Recordings keep the identifier;
where only the text arrives (MAVLink, events of the fleet), `identify` finds row and parameters.
"""

import re
from enum import Enum, IntEnum
from functools import cache
from string import Formatter
from typing import Protocol

FIND_STATION = "Find the ground station that changed it, and stop it."
HAND_BACK = "Take over, or send Continue (MAV_CMD_DO_PAUSE_CONTINUE, param1 = 1)."
CLEAR_GROUND = "Clear the ground below the vehicle."
CLEAR_LANDING = "RTL: clear the home position. LAND: clear the ground below."
CLEAR_SITE = "Clear the site; collect the vehicle there."
AUTHORISE_AGAIN = "Correct the reported condition, then authorise again."
CLEAR_HOME = "Clear the home position; be ready to take over."
SET_CLOCK = "Set the clock that is wrong, then restart the companion."
CORRECT_ISSUE = "Correct the reported condition, or wait if it clears by itself."
WATCH_FLIGHT = "Watch the flight; no action is needed."
WATCH_SEPARATION = "Watch the separation; take over if needed."
WATCH_MODE = "Watch the flight: a mission ends at home, another mode needs a pilot."
NO_ACTION = "No action is needed."
NEXT_ALERT = "Be ready to take over; the next alert states what the companion does."
TAKE_OVER = "Take over by RC or ground station and land."
READ_LOG = "Read the companion's log; correct the cause."
READ_LOG_LATER = "Be ready to take over; read the companion's log after landing."


class Severity(IntEnum):
    """Severity, numbered as in MAV_SEVERITY."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


CRITICAL, ERROR, WARNING, NOTICE, INFO = Severity


class Alert(Enum):
    """One row: severity, text, recommended action. The name in lower case is the identifier."""

    # Control
    CONTROL_RELEASED = (
        WARNING,
        "companion released control: {reason}",
        "In the air fly manually. To hand back: Continue (MAV_CMD_DO_PAUSE_CONTINUE, param1 = 1).",
    )
    PASSIVE = (WARNING, "companion sends no commands: {reason}", "Find who controls the vehicle.")
    OTHER_COMPUTER = (
        WARNING,
        "second companion found: this one keeps control",
        "Stop the second companion of this vehicle.",
    )
    HEARTBEAT_INTRUDER = (
        WARNING,
        "{sender} uses the autopilot's IDs: ignored",
        "Give that component a component ID of its own.",
    )
    VEHICLES_AMBIGUOUS = (
        CRITICAL,
        "vehicles {systems} on the link: flies none",
        "State the vehicle's system ID, companion run --system, or stop forwarding of others.",
    )
    HAND_BACK_IMPOSSIBLE = (
        WARNING,
        "cannot take control: companion has no mission",
        "Keep control; land manually.",
    )
    DISARMED_IN_AIR = (
        CRITICAL,
        "disarmed in flight, falling: {where}",
        "Warn people below to keep clear; send help to the position.",
    )
    FALLING = (
        CRITICAL,
        "falling without thrust: {where}",
        "Warn people below to keep clear; send help to the position.",
    )
    AUTOPILOT_FAILSAFE = (
        WARNING,
        "autopilot reports a failsafe, mode {mode}",
        "Read the autopilot's messages; be ready to take over.",
    )
    HOLD_UNANSWERED = (
        CRITICAL,
        "{cause}, on HOLD: {next_step}",
        HAND_BACK,
    )
    HOLD_ENDED = (CRITICAL, "no operator response: now {mode}", CLEAR_LANDING)
    MODE_NOT_IN_EFFECT = (CRITICAL, "{mode} not entered ({reason}): repeating orders", TAKE_OVER)
    RTL_WITHOUT_EFFECT = (CRITICAL, "RTL had no effect {count} times: trying LAND", CLEAR_GROUND)
    STRANGER_REFUSED = (
        WARNING,
        "{source} is not an accepted operator on this link",
        "Add the station with --operator, or find the sender.",
    )
    PARAMETER_REFUSED = (
        WARNING,
        "{name} {value:g} from {source} refused: use {low:g} to {high:g}",
        "Set a value within the range from an operator station.",
    )
    LIMITS_CHANGED = (
        NOTICE,
        "limits: P(loss) {max_loss:g}, reserve {reserve_frac:g}{evidence}",
        NO_ACTION,
    )

    # Mission on the autopilot
    MISSION_FOREIGN = (
        CRITICAL,
        "unknown mission onboard: operator must decide",
        "Send the companion Continue or RTL (both restore it and return), or fly manually.",
    )
    MISSION_FOREIGN_RESTORING = (CRITICAL, "unknown mission onboard: restoring", FIND_STATION)
    MISSION_CHANGED = (CRITICAL, "mission changed by another station: restoring", FIND_STATION)
    MISSION_CHANGED_ON_GROUND = (WARNING, "mission changed before takeoff: restoring", FIND_STATION)
    MISSION_RESTORED = (NOTICE, "mission restored", NO_ACTION)
    MISSION_LOST = (CRITICAL, "companion cannot verify or restore the mission", NEXT_ALERT)
    MISSION_CHANGED_AGAIN = (CRITICAL, "mission changed again: left as it is", NEXT_ALERT)
    MISSION_CHANGED_LANDING = (CRITICAL, "mission changed in landing: left as it is", NEXT_ALERT)
    COMMAND_REFUSED = (WARNING, "{command} not confirmed: {reason}", READ_LOG_LATER)
    JUMP_IGNORED = (WARNING, "autopilot did not jump to mission item {item}", WATCH_FLIGHT)
    STANDSTILL = (
        CRITICAL,
        "vehicle stands still in its mission: {next_step}",
        "Continue the mission or take over; it hovers until the energy requires a return.",
    )
    LEG_MISSED = (WARNING, "{label} missed: continuing to {next_label}", WATCH_FLIGHT)
    RETURN_BY_MISSION = (WARNING, "returning by the onboard mission", WATCH_FLIGHT)
    RETURN_REFUSED_LAND = (CRITICAL, "mission not usable: landing here", CLEAR_GROUND)
    RETURN_REFUSED_NO_RTL = (CRITICAL, "mission not usable, RTL not safe: take over", TAKE_OVER)
    RETURN_REFUSED_RTL = (CRITICAL, "mission not usable: companion commands RTL", CLEAR_HOME)

    # Gate and return
    GATE_OPEN = (NOTICE, "departing: flying to the customer", WATCH_FLIGHT)
    GATE_STILL_OPEN = (NOTICE, "next leg cleared: continuing to the customer", WATCH_FLIGHT)
    GATE_CLOSED = (WARNING, "turning back: {reason}", WATCH_FLIGHT)
    GATE_CLOSED_POSITION_STALE = (
        WARNING,
        "telemetry stale: returning by the onboard mission",
        WATCH_FLIGHT,
    )
    GATE_OFF = (
        NOTICE,
        "return due, but the gate is disabled: flying on",
        "Command a return, or accept the risk.",
    )
    DEPARTURE_WAITS = (INFO, "waiting above the pad: {reason}", WATCH_FLIGHT)
    LEG_NOT_CLEARED = (WARNING, "next leg or descent not yet cleared: {reason}", WATCH_FLIGHT)
    DIVERTING = (WARNING, "diverting to {site}: {reason}", CLEAR_SITE)
    LANDING_STOP_MOVED = (NOTICE, "landing site is now {site}", WATCH_FLIGHT)
    LANDING_STOP_REFUSED = (WARNING, "landing site kept: {reason}", "Keep the previous site clear.")
    LANDING_STOP_CHOSEN = (NOTICE, "will land at {site}", "Clear the landing site.")
    LANDING_STOP_WAITS = (WARNING, "not yet diverting to {site}: {reason}", WATCH_FLIGHT)

    RETURN_DUE = (
        CRITICAL,
        "P(home): {p_home}, {left_s:.0f} s left: {advice}",
        "Return or land as stated: hand back with Continue, or command RTL.",
    )
    RTL_OUT_OF_REACH = (
        CRITICAL,
        "RTL needs {need_wh:.0f} of {left_wh:.0f} Wh: {advice}",
        "Take over; fly to the stated site or land where it is safe.",
    )

    # Home of the autopilot
    HOME_NOT_TAKEN = (WARNING, "old home kept: RTL goes to the launch pad", "Clear the launch pad.")
    HOME_MOVED = (CRITICAL, "home moved {displacement} by another station", FIND_STATION)
    HOME_RESTORED = (NOTICE, "home restored", NO_ACTION)
    HOME_NOT_RESTORED = (CRITICAL, "autopilot does not restore home: {displacement}", TAKE_OVER)

    # Position, link, telemetry, clock
    POSITION_LOST = (
        CRITICAL,
        "position lost: {reason}",
        "Take over by RC in a mode that needs no position; land.",
    )
    DESCENDING_BLIND = (
        CRITICAL,
        "descending without position, {last_position}",
        "Keep people clear of the last position; collect the vehicle after landing.",
    )
    HEIGHT_DOUBT = (
        WARNING,
        "height uncertain: GNSS differs by over {limit_m:.0f} m",
        "Expect a return with the parcel; watch the height at the landing.",
    )
    POSITION_BACK = (NOTICE, "position recovered after {duration_s:.0f} s", WATCH_FLIGHT)
    LINK_BACK = (WARNING, "autopilot link recovered after {duration_s:.0f} s", WATCH_FLIGHT)
    CLOCK_JUMPED = (NOTICE, "autopilot clock jumped {jump_s:.0f} s: not counted", READ_LOG_LATER)
    AUTOPILOT_REBOOTED = (
        WARNING,
        "autopilot clock went back {back_s:.0f} s: rebooted?",
        "Watch the flight; check the autopilot's power supply after landing.",
    )
    TELEMETRY_STOPPED = (
        WARNING,
        "autopilot telemetry stopped: requesting again",
        "Wait; if it repeats, check the link to the autopilot.",
    )
    TELEMETRY_MISSING = (
        WARNING,
        "autopilot does not send: {messages}",
        "Check the stream rates of the autopilot.",
    )
    NEIGHBOUR_LOST = (WARNING, "no reports from nearby drone: {names}", WATCH_SEPARATION)
    NEIGHBOUR_NO_SETPOINTS = (
        WARNING,
        "nearby drone: companion cannot avoid it here",
        WATCH_SEPARATION,
    )
    STRANGERS_FLOOD = (
        WARNING,
        "unknown senders flood the link: theirs dropped",
        "Find the program that sends to the companion's port, and stop it.",
    )
    PROCESS_STALLED = (
        WARNING,
        "companion stalled for {duration_s:.1f} s",
        "Check the load of the companion computer.",
    )
    COMPANION_FAILED = (CRITICAL, "companion failed: it sends no more commands", WATCH_MODE)
    COMPANION_STOPPED = (WARNING, "companion stopped: vehicle stays in {mode}", WATCH_MODE)
    COMPANION_STOPPED_ON_GROUND = (
        WARNING,
        "companion stopped: on the ground, {armed_state}",
        "If it is still armed, keep clear and disarm it.",
    )
    RECORD_LOST = (WARNING, "recording stopped, {reason}", "Free disk space after landing.")
    SIGNING_CLOCKS_DIFFER = (
        CRITICAL,
        "signing: autopilot clock {behind_s:.0f} s behind",
        SET_CLOCK,
    )
    SIGNING_CLOCK_AUTOPILOT = (CRITICAL, "autopilot signing clock: {utc}", SET_CLOCK)
    SIGNING_CLOCK_COMPANION = (CRITICAL, "companion clock: {utc}", SET_CLOCK)
    SIGNING_CLOCK_REMEDY = (
        CRITICAL,
        "on the ground: set the clock, restart companion",
        SET_CLOCK,
    )

    # Start and landing
    READY = (NOTICE, "ready: mission uploaded and verified", "Authorise if you have not yet.")
    START_CONDITION_MISSING = (WARNING, "{finding}", CORRECT_ISSUE)
    START_WAITS = (INFO, "waiting: {finding}", CORRECT_ISSUE)
    START_REFUSED = (ERROR, "start refused: {finding}", AUTHORISE_AGAIN)
    START_NOT_POSSIBLE_NOW = (WARNING, "start conditions changed: authorise again", AUTHORISE_AGAIN)
    NO_TAKE_OFF = (ERROR, "no take-off: {reason}", READ_LOG)
    PLANNING = (NOTICE, "still planning the route", "Wait; no action is needed.")
    PARAMETERS_AWAITED = (
        WARNING,
        "waiting for {count} parameters: {names}",
        "Check the link to the autopilot; the companion repeats the requests.",
    )
    PARAMETERS_NOT_SET = (WARNING, "could not set {names}", READ_LOG)
    EARLIER_SETTINGS_IN_FORCE = (
        WARNING,
        "settings of an earlier flight active: restore them",
        "On the ground: disarm, then run `companion restore`.",
    )
    SETTINGS_NOT_RESTORED = (
        WARNING,
        "settings not restored: {reason}",
        "Run `companion restore` when the vehicle is disarmed.",
    )
    LANDED_STILL_ARMED = (WARNING, "landed, still armed: disarm manually", "Disarm.")
    DELIVERED = (NOTICE, "delivered: {evidence}", NO_ACTION)
    RELEASED_IN_DOUBT = (
        WARNING,
        "parcel released, height uncertain by {difference_m:.0f} m",
        "Check the parcel: it may have fallen from a greater height.",
    )
    RELEASE_UNCONFIRMED = (
        ERROR,
        "parcel release not confirmed: assumed on board",
        "Expect the parcel on the vehicle at landing.",
    )

    # Wind, energy, model
    FLEET_WIND = (NOTICE, "wind of the fleet: {news}", NO_ACTION)
    HEADING_UNUSABLE = (
        WARNING,
        "wind estimate: {finding}",
        "Check compass and GNSS after landing; expect a return.",
    )
    BATTERY_CHOSEN = (
        WARNING,
        "battery monitor in use: {monitor}",
        "Check the battery monitors' settings.",
    )
    MONITOR_FROZEN = (
        WARNING,
        "battery monitor frozen: using the power model",
        "Expect an early return; check the battery monitor after landing.",
    )
    VOLTAGES_DIFFER = (
        WARNING,
        "battery at {system_v:.1f} and {monitor_v:.1f} V: lower used",
        "Check the number of cells and the voltage calibration of the autopilot.",
    )
    CURRENT_SENSOR_LOW = (
        WARNING,
        "current sensor reads {gain:.0%}: using the power model",
        "Expect an early return; calibrate the current sensor before the next flight.",
    )
    PACK_POWER_LOW = (
        WARNING,
        "battery gives at most {power_w:.0f} W: flying slower",
        "Expect an early return; warm or replace the pack before the next flight.",
    )
    DRAW_CHANGED = (
        WARNING,
        "power draw {scale:.1f} +- {std:.1f} times the model",
        "Check motors and propellers after landing.",
    )
    ENVELOPE_LEFT = (WARNING, "outside the recorded range: {finding}", "Expect an early return.")
    MONITOR_DOUBT = (WARNING, "model monitor: {finding}", "Correct the cause; reset the monitor.")

    @property
    def identifier(self) -> str:
        """Name in logs and messages."""
        return self.name.lower()

    @property
    def severity(self) -> Severity:
        """Severity of each report of this alert."""
        return self.value[0]

    @property
    def text_template(self) -> str:
        """Text with its parameters in braces."""
        return self.value[1]

    @property
    def recommended_action(self) -> str:
        """Recommended action of the operator."""
        return self.value[2]


AlertParameter = str | float


class AlertSink(Protocol):
    """Receives the alerts of an adapter."""

    def __call__(self, alert: Alert, **parameters: AlertParameter) -> None:
        """Report an alert with its parameters."""
        ...


def parse_alert_text(text: str) -> tuple[Alert, dict[str, str]] | None:
    """Find the alert of a text received over MAVLink, and its parameters as text.

    The row with the longest fixed text wins. Returns None for a text of another sender.
    """
    for alert, pattern in _alert_patterns_longest_first():
        found = pattern.fullmatch(text)
        if found is not None:
            return alert, found.groupdict()
    return None


def is_text_of_any_alert(text: str, *alerts: Alert) -> bool:
    """Return whether a received text is one of these alerts."""
    found = parse_alert_text(text)
    return found is not None and found[0] in alerts


@cache
def _alert_patterns_longest_first() -> list[tuple[Alert, re.Pattern[str]]]:
    found: list[tuple[int, Alert, re.Pattern[str]]] = []
    for alert in Alert:
        pattern, fixed = "", 0
        for literal, name, _, _ in Formatter().parse(alert.text_template):
            pattern += re.escape(literal) + (f"(?P<{name}>.+)" if name else "")
            fixed += len(literal)
        if fixed:
            found.append((fixed, alert, re.compile(pattern, re.DOTALL)))
    return [(alert, pattern) for _, alert, pattern in sorted(found, key=lambda row: -row[0])]
