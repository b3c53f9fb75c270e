"""One autopilot on a link: finds it, tells PX4 from ArduPilot, turns its messages into events
and the orders of the pilot into messages.

Only component 1 of the chosen system is believed. Orders wait here for their acknowledgement, or
until telemetry shows their effect. An acknowledgement is reported but proves nothing: the pilot
looks for the effect in telemetry.
"""

from collections.abc import Callable
from typing import Any

from companion.adapters.autopilots.ardupilot import ArduPilot
from companion.adapters.autopilots.codec import AUTOPILOT, COMPONENT, mavlink
from companion.adapters.autopilots.commands import RETRY_S, CommandQueue, PendingCommand
from companion.adapters.autopilots.mission_transfer import PAUSE_S, MissionDownload, MissionUpload
from companion.adapters.autopilots.mission_wire import wire_items
from companion.adapters.autopilots.parameters import ParameterClient
from companion.adapters.autopilots.px4 import Px4
from companion.adapters.autopilots.telemetry import AutopilotProfile, boot_s, translate
from companion.adapters.clock import AutopilotClock
from companion.core.mission.actions import (
    Arm,
    AskBoard,
    AskParameters,
    AskTelemetry,
    ClearMission,
    Configure,
    Disarm,
    FlyVelocity,
    JumpTo,
    Order,
    ReadMissionBack,
    Release,
    SetGroundSpeed,
    SetHome,
    SetMode,
    UploadMission,
)
from companion.core.mission.events import (
    CLAIM,
    CLAIM_STEP_S,
    AutopilotParameters,
    BoardKnown,
    ClockLeapt,
    ClockStepped,
    Event,
    Identified,
    MissionProgress,
    MissionReadBack,
    MissionTouched,
    MissionUploaded,
    Mode,
    ModeNow,
    OrderRefused,
    OtherComputer,
    ParametersSet,
    Position,
    StreamsAsked,
    VehicleState,
)
from companion.core.mission.mission_items import MissionItem, Spot, differences

HEARTBEATS_TO_TRUST = 3
"""One heartbeat may be anybody's; three are a vehicle."""

LISTEN_S = 2.0
"""How long we listen for another onboard computer before we speak (its heartbeat comes at 1 Hz);
three heartbeats at their usual rate are as long.
"""

HEARTBEATS_WITHOUT_TIME = 10
"""After so many we take a vehicle that tells no time as it is; retries then wait for telemetry."""

ECHO_S = 1.5
"""When a jump is sent again that only MISSION_CURRENT confirms: PX4 sends that once a second."""

ARM_AGAIN_S = 0.1
ARM_TRIES = 3
"""ARM is repeated only faster than a person can disarm (flown: a disarm 0.3 s after arming). Later
an unanswered ARM may have been obeyed and undone, and nobody arms again what a person disarmed.
"""

ARM_ANSWER_S = 3.0
"""How long the answer to the last ARM is waited for: heartbeats, which show its effect, come at
1 Hz and lag by up to a second.
"""

MODE_ANSWER_S = 3.0
"""How long the answer to a mode command is waited for. It is sent once: a person may have selected
another mode, or the former one again, before a repetition. The pilot repeats it where it may.
"""

VELOCITY_AND_ACCELERATION = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)
"""What a set-point says; the heading is the autopilot's own."""

STREAM = "stream "

PROFILES: dict[int, type[ArduPilot] | type[Px4]] = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ArduPilot,
    mavlink.MAV_AUTOPILOT_PX4: Px4,
}
NOT_VEHICLES = (
    mavlink.MAV_TYPE_GCS,
    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
    mavlink.MAV_TYPE_GIMBAL,
    mavlink.MAV_TYPE_ADSB,
)


class AutopilotPort:
    """Hears messages, gives orders; the caller moves the bytes and the time."""

    def __init__(
        self, send: Callable[[Any], None], clock: AutopilotClock, system_id: int | None = None
    ) -> None:
        self._send = send
        self._clock = clock
        self._wanted_system = system_id
        self._heartbeats: dict[tuple[int, int], int] = {}
        self._stamps: dict[int, tuple[float, float]] = {}
        self._times_asked = 0
        self._time_asked: dict[int, int] = {}
        self._times: dict[int, float] = {}
        self._beat_at_s = -1.0
        self.profile: AutopilotProfile | None = None
        self.system_id: int | None = None
        self._commands = CommandQueue(send)
        self._progress: MissionProgress | None = None
        self._parameters: ParameterClient | None = None
        self._upload: MissionUpload | None = None
        self._upload_from_s = 0.0
        self._download: MissionDownload | None = None
        self._expected: tuple[MissionItem, ...] = ()
        self._first_only = False
        self._asking_parameters = False
        self._configuring = False
        self._refused: list[str] = []
        self._asking_streams = False
        self._home = Spot(0.0, 0.0, 0.0)

    # --- hearing -------------------------------------------------------------------------------

    def on_message(self, message: Any) -> list[Event]:
        """Return the events in a message; foreign and stale messages have none."""
        system, component = message.get_srcSystem(), message.get_srcComponent()
        kind = message.get_type()
        if self.profile is None:
            self._note_stamp(message, system, component)
            if component != AUTOPILOT and self._wanted_system in (None, system):
                return self._other_computer(message, component)
            return self._identify(message, system) if kind == "HEARTBEAT" else []
        if system != self.system_id:
            return []
        if component != AUTOPILOT:
            return self._other_computer(message, component)
        if kind == "HEARTBEAT":
            if message.type in NOT_VEHICLES:
                return []
            self._ask_time_if_it_stands(system)
        events, t_s = self._time(message)
        if t_s is None:
            return events
        handled = self._answer(message, kind, t_s)
        if handled is not None:
            return events + handled
        values = self._parameters.values if self._parameters is not None else {}
        found = translate(message, self.profile, values, t_s)
        for event in found:
            if isinstance(event, Position) and self._home.lat_deg == 0.0:
                self._home = Spot(event.lat_deg, event.lon_deg, event.alt_amsl_m)
        ended = [done for event in found for done in self._commands.on_telemetry(event, t_s)]
        self._progress = next((e for e in found if isinstance(e, MissionProgress)), self._progress)
        return events + found + ended

    def on_time_answer(self, message: Any) -> None:
        """Take the answer to our own TIMESYNC request: what the autopilot's clock says."""
        system = message.get_srcSystem()
        if message.get_srcComponent() != AUTOPILOT or self._time_asked.get(system) != message.ts1:
            return
        del self._time_asked[system]
        if self.profile is None:
            self._times[system] = message.tc1 / 1e9
        elif system == self.system_id:
            self._clock.synchronise(message.tc1 / 1e9)

    def _ask_time(self, system: int) -> None:
        self._times_asked += 1
        self._time_asked[system] = self._times_asked
        self._send(mavlink.MAVLink_timesync_message(0, self._times_asked))

    def _ask_time_if_it_stands(self, system: int) -> None:
        """Ask for the time while nothing tells it: ArduPilot sends no stamp before it is asked.

        A clock that stands still would never let a lost order be sent again.
        """
        if self._clock.t_s == self._beat_at_s:
            self._ask_time(system)
        self._beat_at_s = self._clock.t_s

    def may_be_ours(self, message: Any) -> bool:
        """Tell whether a message is the heartbeat of a vehicle that we could belong to."""
        return (
            message.get_type() == "HEARTBEAT"
            and message.get_srcComponent() == AUTOPILOT
            and message.autopilot in PROFILES
            and message.type not in NOT_VEHICLES
            and self._wanted_system in (None, message.get_srcSystem())
        )

    def _note_stamp(self, message: Any, system: int, component: int) -> None:
        """Remember over how long a system has been heard, where its messages tell."""
        stamp_s = boot_s(message)
        if stamp_s is not None and component == AUTOPILOT:
            first_s, _ = self._stamps.get(system, (stamp_s, stamp_s))
            self._stamps[system] = (min(first_s, stamp_s), stamp_s)

    def _identify(self, message: Any, system: int) -> list[Event]:
        """Count heartbeats until one system is trusted to be our vehicle."""
        profile = PROFILES.get(message.autopilot)
        if profile is None or not self.may_be_ours(message):
            return []
        key = (system, message.autopilot)
        self._heartbeats[key] = self._heartbeats.get(key, 0) + 1
        if not self._clock.known and system not in self._stamps:
            self._ask_time(system)
        if self._heartbeats[key] < HEARTBEATS_TO_TRUST:
            return []
        first_s, last_s = self._stamps.get(system, (0.0, LISTEN_S))
        if last_s - first_s < LISTEN_S or not self._set_clock(system, self._heartbeats[key]):
            return []
        chosen: AutopilotProfile = profile()
        self.profile = chosen
        self.system_id = system
        self._parameters = ParameterClient(self._send, bytewise=chosen.bytewise_parameters)
        self._parameters.aim(system)
        t_s = self._clock.t_s
        state = [e for e in translate(message, chosen, {}, t_s) if isinstance(e, VehicleState)]
        return [*state, Identified(t_s, chosen.autopilot_kind, system)]

    def _set_clock(self, system: int, heartbeats: int) -> bool:
        """Set the clock by what the vehicle told; False while it is worth waiting for that.

        An order that is given at time 0 would look overdue at the first stamp, be sent twice, and
        be answered twice (seen on PX4 1.18 and ArduCopter 4.7).
        """
        if system in self._stamps:
            self._clock.stamp(self._stamps[system][1])
        elif system in self._times:
            self._clock.synchronise(self._times[system])
        return self._clock.known or heartbeats >= HEARTBEATS_WITHOUT_TIME

    def _other_computer(self, message: Any, component: int) -> list[Event]:
        """What a computer beside us says of itself: its heartbeat, or the named value.

        ArduPilot passes no heartbeat on to a link where the same component was heard: to us, none
        of a second companion. Named values it does.
        """
        match message.get_type():
            case "HEARTBEAT":
                return self._heartbeat_beside(message, component)
            case "NAMED_VALUE_FLOAT" if message.name == CLAIM and 0.0 <= message.value < 1e7:
                since_ms = round(message.value / CLAIM_STEP_S) * round(1000.0 * CLAIM_STEP_S)
                told = {"flies": since_ms > 0, "since_ms": since_ms or None}
                return [OtherComputer(self._clock.t_s, active=True, component=component, **told)]
            case _:
                return []

    def _heartbeat_beside(self, message: Any, component: int) -> list[Event]:
        """Of a companion, or of whoever says that it flies; any other computer is harmless."""
        flies = bool(message.base_mode & mavlink.MAV_MODE_FLAG_AUTO_ENABLED)
        onboard = message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
        if component != COMPONENT and not (onboard and flies):
            return []
        status = message.system_status
        return [
            OtherComputer(
                self._clock.t_s,
                active=status not in (mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_BOOT),
                booting=status == mavlink.MAV_STATE_BOOT,
                component=component,
                flies=flies,
                since_ms=message.custom_mode or None,
            )
        ]

    def _time(self, message: Any) -> tuple[list[Event], float | None]:
        stamp_s = boot_s(message)
        if stamp_s is None:
            return [], self._clock.t_s
        reading = self._clock.stamp(stamp_s)
        events: list[Event] = []
        if reading.back_s > 0.0:
            events.append(ClockStepped(self._clock.t_s, reading.back_s))
        if reading.ahead_s > 0.0:
            events.append(ClockLeapt(self._clock.t_s, reading.ahead_s))
        return events, reading.t_s

    def _answer(self, message: Any, kind: str, t_s: float) -> list[Event] | None:
        """Take what belongs to a conversation of ours; `None` for everything else."""
        target = getattr(message, "target_system", 0)
        mine = target in (0, self.system_id) and getattr(message, "target_component", 0) in (
            0,
            COMPONENT,
        )
        if kind == "COMMAND_ACK":
            return (
                self._without_refused_streams(self._commands.on_ack(message, t_s)) if mine else []
            )
        if kind == "PARAM_VALUE" and self._parameters is not None:
            self._parameters.on_value(message)
            return self._parameters_events(t_s)
        if kind == "PARAM_ERROR" and self._parameters is not None:
            if mine:
                self._parameters.on_error(message)
            return self._parameters_events(t_s)
        if kind == "AUTOPILOT_VERSION":
            return [BoardKnown(t_s, _board(message))]
        if kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            if self._upload is not None and mine:
                self._upload.on_message(message, t_s)
            return []
        if kind in ("MISSION_COUNT", "MISSION_ITEM_INT"):
            if self._download is not None and mine:
                self._download.on_message(message, t_s)
            return self._transfer_events(t_s)
        if kind == "MISSION_ACK":
            if mine and self._upload is not None:
                self._upload.on_message(message, t_s)
            elif mine and self._download is not None:
                self._download.on_message(message, t_s)
            elif not mine and _ends_a_write(message):
                self._commands.drop("jump", t_s)
                words = f"{message.target_system}/{message.target_component} wrote the mission"
                return [MissionTouched(t_s, words)]
            return self._transfer_events(t_s)
        return None

    # --- orders --------------------------------------------------------------------------------

    def order(self, order: Order, t_s: float) -> None:
        """Give an order."""
        profile, system = self.profile, self.system_id
        if profile is None or system is None:
            return
        match order:
            case AskTelemetry():
                self._ask_streams(profile, system, t_s)
            case AskBoard():
                version = (float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION),)
                asks = mavlink.MAV_CMD_REQUEST_MESSAGE
                self._command("board", STREAM + "board", asks, version, t_s, quiet=True)
            case AskParameters():
                self._read_parameters(order.names, t_s)
            case Configure():
                if self._parameters is not None:
                    self._configuring = True
                    self._parameters.set(order.values, t_s)
            case UploadMission():
                self._download = None
                wire = wire_items(
                    order.items,
                    home_items=profile.home_items,
                    home=self._home,
                    free_yaw=profile.free_yaw,
                )
                self._upload = MissionUpload(self._send, system, wire, t_s, self._upload_from_s)
            case ClearMission():
                self._download = None
                self._upload = MissionUpload(self._send, system, (), t_s)
            case ReadMissionBack():
                self._upload = None
                self._expected = order.items
                self._first_only = order.first_only
                window = order.window if profile.reads_any_item else 1
                self._download = MissionDownload(
                    self._send, system, profile.home_items, t_s, order.pace_s, window
                )
            case SetMode():
                name = f"mode {order.mode.value}"
                entry = self._entry(
                    name, mavlink.MAV_CMD_DO_SET_MODE, profile.mode_params(order.mode)
                )
                entry.shows = lambda event: _shows_mode(event, order.mode)
                entry.most_tries, entry.answer_s = 1, MODE_ANSWER_S
                self._commands.submit("mode", entry, t_s, replace=True)
            case Arm():
                entry = self._entry("arm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,))
                entry.shows = lambda event: _shows_armed(event, armed=True)
                entry.again_s, entry.most_tries = ARM_AGAIN_S, ARM_TRIES
                entry.answer_s = ARM_ANSWER_S
                self._commands.submit("arm", entry, t_s)
            case Disarm():
                entry = self._entry("disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,))
                entry.shows = lambda event: _shows_armed(event, armed=False)
                self._commands.submit("arm", entry, t_s)
            case JumpTo():
                message, command = profile.jump(system, order.index + profile.home_items)
                entry = PendingCommand(
                    f"jump to item {order.index}",
                    lambda _attempt: message,
                    command,
                    shows=lambda event: _shows_item(event, order),
                    again_s=ECHO_S if command is None else RETRY_S,
                )
                self._watch_item(entry, order)
                self._commands.submit("jump", entry, t_s, replace=True)
            case SetGroundSpeed():
                params = (1.0, order.ground_speed_mps, -1.0)
                self._command("speed", "ground speed", mavlink.MAV_CMD_DO_CHANGE_SPEED, params,
                              t_s, replace=True)  # fmt: skip
            case SetHome():
                entry = PendingCommand(
                    "set home", _home_setter(system, order), mavlink.MAV_CMD_DO_SET_HOME
                )
                self._commands.submit("home", entry, t_s, replace=True)
            case FlyVelocity():
                self._send(
                    mavlink.MAVLink_set_position_target_local_ned_message(
                        self._clock.boot_ms,
                        system,
                        AUTOPILOT,
                        mavlink.MAV_FRAME_LOCAL_NED,
                        VELOCITY_AND_ACCELERATION,
                        *(0.0, 0.0, 0.0),
                        *order.vel_ned_mps,
                        *order.accel_ned_mps2,
                        *(0.0, 0.0),
                    )
                )
            case Release():
                params = (1.0, float(mavlink.GRIPPER_ACTION_RELEASE))
                self._command("release", "release", mavlink.MAV_CMD_DO_GRIPPER, params, t_s)
            case _:
                raise TypeError(f"unknown order {order!r}")

    def _read_parameters(self, names: tuple[str, ...], t_s: float) -> None:
        """Ask for these parameters (and those that tell which telemetry is real)."""
        if self._parameters is None or self.profile is None:
            return
        self._asking_parameters = True
        self._parameters.read(dict.fromkeys((*names, *self.profile.trust_parameters)), t_s)

    def drop_orders(self) -> None:
        """Forget everything that is still being sent, retried or waited for."""
        self._commands.clear(self._clock.t_s)
        self._upload = None
        self._download = None
        self._asking_streams = False
        self._asking_parameters = False
        self._configuring = False
        if self._parameters is not None:
            self._parameters.clear()

    def tick(self, t_s: float) -> list[Event]:
        """Retry what is due and report what ended."""
        events = self._without_refused_streams(self._commands.tick(t_s)) + self._streams_events(t_s)
        if self._upload is not None:
            self._upload.tick(t_s)
        if self._download is not None:
            self._download.tick(t_s)
        events += self._transfer_events(t_s)
        if self._parameters is not None:
            self._parameters.tick(t_s)
            events += self._parameters_events(t_s)
        return events

    # --- inside --------------------------------------------------------------------------------

    def _command(
        self,
        lane: str,
        name: str,
        command: int,
        params: tuple[float, ...],
        t_s: float,
        *,
        replace: bool = False,
        quiet: bool = False,
    ) -> None:
        entry = self._entry(name, command, params)
        entry.quiet = quiet
        self._commands.submit(lane, entry, t_s, replace=replace)

    def _watch_item(self, entry: PendingCommand, jump: JumpTo) -> None:
        """Repeat a jump only while reports show the item that is flown now, in the same list."""
        if self._progress is None:
            return
        at = _item_of(self._progress)
        entry.unchanged = lambda event: _item_of(event) == at
        entry.superseded = lambda event: (
            _item_of(event) not in (None, at) and not _shows_item(event, jump)
        )

    def _entry(self, name: str, command: int, params: tuple[float, ...]) -> PendingCommand:
        """A COMMAND_LONG that is still to be sent."""
        system = self.system_id or 1
        full = (*params, *([0.0] * (7 - len(params))))

        def make(attempt: int) -> Any:
            return mavlink.MAVLink_command_long_message(system, AUTOPILOT, command, attempt, *full)

        return PendingCommand(name, make, command)

    def _ask_streams(self, profile: AutopilotProfile, system: int, t_s: float) -> None:
        self._refused = []
        self._asking_streams = True
        wanted = [(name, number, 1e6 / hz) for name, number, hz, _ in profile.streams]
        wanted += [(f"-{number}", number, -1.0) for number in profile.unwanted_streams]
        for name, number, interval_us in wanted:
            self._command(
                "streams",
                STREAM + name,
                mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                (float(number), interval_us),
                t_s,
                quiet=True,
            )

    def _without_refused_streams(self, events: list[Event]) -> list[Event]:
        """Keep refused streams for one report; pass everything else on."""
        passed: list[Event] = []
        for event in events:
            if isinstance(event, OrderRefused) and event.order.startswith(STREAM):
                self._refused.append(event.order.removeprefix(STREAM))
            else:
                passed.append(event)
        return passed

    def _streams_events(self, t_s: float) -> list[Event]:
        """Nothing more to ask for: say so once."""
        if not self._asking_streams or self._commands.pending("streams"):
            return []
        self._asking_streams = False
        wanted = (
            {name for name, _, _, needed in self.profile.streams if needed} if self.profile else {}
        )
        return [StreamsAsked(t_s, tuple(name for name in self._refused if name in wanted))]

    def _transfer_events(self, t_s: float) -> list[Event]:
        if self._upload is not None and self._upload.done is not None:
            reason, self._upload = self._upload.done, None
            if reason:
                self._upload_from_s = t_s + PAUSE_S
            return [MissionUploaded(t_s, reason or None)]
        if self._download is not None and self._download.done is not None:
            download, self._download = self._download, None
            if download.done:
                return [MissionReadBack(t_s, (download.done,), complete=False)]
            return [MissionReadBack(t_s, differences(self._expected, download.items))]
        return self._first_difference(t_s)

    def _first_difference(self, t_s: float) -> list[Event]:
        """End a download whose newest item shows already that the mission is another."""
        download = self._download
        if download is None or not self._first_only:
            return []
        so_far = download.items
        at = len(so_far) - 1
        found = differences(self._expected[at : at + 1], so_far[at:]) if so_far else ()
        if not found:
            return []
        download.cancel()
        self._download = None
        return [MissionReadBack(t_s, found)]

    def _parameters_events(self, t_s: float) -> list[Event]:
        desk = self._parameters
        if desk is None or desk.busy:
            return []
        if self._configuring:
            self._configuring = False
            return [
                ParametersSet(t_s, tuple(desk.failed)),
                AutopilotParameters(t_s, dict(desk.values)),
            ]
        if self._asking_parameters:
            self._asking_parameters = False
            return [AutopilotParameters(t_s, dict(desk.values))]
        return []


def _board(message: Any) -> str:
    """The number that the board was made with; "" where it has none, as simulators have."""
    long = bytes(message.uid2).hex()
    short = f"{message.uid:016x}"
    return next((number for number in (long, short) if number.strip("0")), "")


def _shows_armed(event: Event, *, armed: bool) -> bool:
    return isinstance(event, VehicleState) and event.armed is armed


def _shows_mode(event: Event, mode: Mode) -> bool:
    return isinstance(event, VehicleState | ModeNow) and event.mode is mode


def _shows_item(event: Event, jump: JumpTo) -> bool:
    return isinstance(event, MissionProgress) and event.index in (jump.index, *jump.passes)


def _item_of(event: Event) -> tuple[int | None, ...] | None:
    """Return item, length and id of the list that a report names; `None`: no such report."""
    named = isinstance(event, MissionProgress)
    return (event.index, event.total, event.mission_id) if named else None


def _home_setter(system: int, order: SetHome) -> Callable[[int], Any]:
    """DO_SET_HOME as COMMAND_INT: a place in the floats of COMMAND_LONG is a metre off."""
    place = round(order.lat_deg * 1e7), round(order.lon_deg * 1e7), order.alt_amsl_m
    message = mavlink.MAVLink_command_int_message(
        system,
        AUTOPILOT,
        mavlink.MAV_FRAME_GLOBAL,
        mavlink.MAV_CMD_DO_SET_HOME,
        *(0, 0),
        *(0.0, 0.0, 0.0, 0.0),
        *place,
    )
    return lambda _attempt: message


def _ends_a_write(message: Any) -> bool:
    """MISSION_ACK ends an upload or a clearing; a download ends with the station's own."""
    accepted = message.type == mavlink.MAV_MISSION_ACCEPTED
    return accepted and message.mission_type == mavlink.MAV_MISSION_TYPE_MISSION
