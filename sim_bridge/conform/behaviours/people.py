"""RC override, other components on the system, other stations, a home that moves, the parcel."""

from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import Behaviour, Finding, Where
from sim_bridge.conform.behaviours.mission import waypoint
from sim_bridge.conform.behaviours.mission_flight import fly_straight
from sim_bridge.conform.client import Identity
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.subject import Subject

_STRANGER = Identity(200, 190, mavlink.MAV_TYPE_GCS)
_CENTRED = (1500, 1500, 1500, 1500)
_PUSHED = (1500, 1900, 1500, 1500)
_IGNORE = 65535
_READY_S = 90.0
_LOWER_M = 20.0
_FAR_M = 3000.0
_THEIRS_M = 200.0
"""East of home: where another station's list begins."""


def _override(s: Subject, channels: tuple[int, ...], for_s: float, whom: Identity | None) -> None:
    """RC_CHANNELS_OVERRIDE at 20 Hz; the channels after those given are left alone."""
    end_s = s.client.t_s + for_s
    fields = {f"chan{i + 1}_raw": value for i, value in enumerate(channels)}
    fields |= {f"chan{i}_raw": _IGNORE for i in range(len(channels) + 1, 9)}
    while s.client.t_s < end_s:
        s.client.send("RC_CHANNELS_OVERRIDE", whom, **fields)
        s.client.collect(0.05)


def _release(s: Subject, whom: Identity | None = None) -> None:
    _override(s, (0, 0, 0, 0), 0.3, whom)


def _channel_seen(s: Subject) -> bool:
    heard = [m for m in s.client.heard if m.get_type() == "RC_CHANNELS"]
    return any(m.chan2_raw == _PUSHED[1] for m in heard)


def _override_seen(s: Subject) -> bool:
    """Whether an override appears in RC_CHANNELS, on the ground."""
    _override(s, _PUSHED, 3.0, None)
    seen = _channel_seen(s)
    _release(s)
    return seen


def _override_by_stranger(s: Subject) -> bool:
    _release(s)
    s.client.collect(2.0)
    s.client.forget()
    _override(s, _PUSHED, 3.0, _STRANGER)
    seen = _channel_seen(s)
    _release(s, _STRANGER)
    return seen


def _sticks_in_hold(s: Subject) -> Finding:
    """Sticks centred, then the pitch stick pushed over in 0.5 s, in the holding mode in the air."""
    _override(s, _CENTRED, 2.0, None)
    before = s.mode
    for pulse_us in range(1540, 1901, 40):
        _override(s, (1500, pulse_us, 1500, 1500), 0.04, None)
    _override(s, _PUSHED, 1.5, None)
    s.client.collect(0.8)
    after = s.mode
    _release(s)
    return Finding("nothing" if after == before else f"mode {after}", f"{before} to {after}")


def _joystick_in_hold(s: Subject) -> Finding:
    """MANUAL_CONTROL centred, then pushed forward in 0.5 s, in the holding mode in the air."""
    _joystick(s, 0, 2.0)
    before = s.mode
    for forward in range(100, 1001, 100):
        _joystick(s, forward, 0.04)
    _joystick(s, 1000, 1.5)
    s.client.collect(0.8)
    after = s.mode
    return Finding("nothing" if after == before else f"mode {after}", f"{before} to {after}")


def _joystick(s: Subject, forward: int, for_s: float) -> None:
    end_s = s.client.t_s + for_s
    while s.client.t_s < end_s:
        s.client.send(
            "MANUAL_CONTROL", target=s.client.target[0], x=forward, y=0, z=500, r=0, buttons=0
        )
        s.client.collect(0.05)


def _companion_beats(s: Subject) -> str:
    """Whether the autopilot goes on as the same with a companion's HEARTBEAT on its link."""
    for _ in range(5):
        s.client.beat(s.client.companion)
        s.client.collect(0.6)
    beats = [m for m in s.client.heard if m.get_type() == "HEARTBEAT"]
    return "alike" if beats and len({m.custom_mode for m in beats}) == 1 else "otherwise"


def _foreign_text(s: Subject) -> bool:
    """Whether it takes a companion's HEARTBEAT for its own: the link hears it back."""
    for _ in range(5):
        s.client.beat(s.client.companion)
        s.client.collect(0.6)
    return (s.client.companion.system, s.client.companion.component) in s.client.others


def _command_from_companion(s: Subject) -> str:
    """A command from the vehicle's own system, another component: its target in the ACK."""
    s.client.beat(s.client.companion)
    number = mavlink.MAV_CMD_REQUEST_MESSAGE
    version = float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    s.client.say_command(number, version, as_whom=s.client.companion)
    ack = s.client.hear("COMMAND_ACK", 3.0, lambda m: m.command == number)
    if ack is None:
        return "no answer"
    return f"answered to component {ack.target_component}"


def _timesync(s: Subject) -> Finding:
    """Whether it asks TIMESYNC of its own accord."""
    own = [0]

    def count() -> bool:
        message = s.client.latest.get("TIMESYNC")
        if message is not None and message.tc1 == 0:
            own[0] += 1
        return False

    s.client.until(count, 4.0)
    return Finding("asks" if own[0] else "only answers")


def _ping(s: Subject) -> bool:
    s.client.send("PING", time_usec=1, seq=77, target_system=0, target_component=0)
    return s.client.hear("PING", 2.0, lambda m: m.seq == 77) is not None


def _gripper(action: float, s: Subject) -> Finding:
    """DO_GRIPPER: the first answer, and those that follow within 6 s."""
    number = mavlink.MAV_CMD_DO_GRIPPER
    s.client.forget()
    s.client.command(number, 1.0, action)
    s.client.collect(6.0)
    acks = [m for m in s.client.heard if m.get_type() == "COMMAND_ACK" and m.command == number]
    results = mavlink.enums["MAV_RESULT"]
    words = [results[m.result].name.removeprefix("MAV_RESULT_") for m in acks]
    told = [text for text in s.client.texts() if "ripper" in text]
    return Finding(", then ".join(words) or "no answer", "; ".join(told))


def _command(number: int, *params: float):
    def see(s: Subject) -> str:
        return s.client.command(number, *params)

    return see


def _fence_enable(s: Subject) -> str:
    answer = s.client.command(mavlink.MAV_CMD_DO_FENCE_ENABLE, 1.0)
    s.client.collect(0.5)
    s.client.command(mavlink.MAV_CMD_DO_FENCE_ENABLE, 0.0)
    return answer


def _offboard_ack(s: Subject) -> str:
    """PX4 accepts OFFBOARD without set-points while disarmed: then arming tells."""
    if not s.is_px4:
        return "there is none"
    answer = s.set_mode("OFFBOARD")
    s.client.collect(1.5)
    mode = s.mode
    armed = s.arm_once()
    s.disarm_once()
    return f"{answer}, {mode}, arming {armed}"


def _speed_type_ack(s: Subject) -> str:
    """DO_CHANGE_SPEED with a type that nobody has defined, in the air."""
    return s.client.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 77.0, 3.0, -1.0)


def _home_here(s: Subject) -> str:
    position = s.position()
    answer = s.client.command(mavlink.MAV_CMD_DO_SET_HOME, 1.0)
    home = s.client.hear("HOME_POSITION", 3.0)
    if home is None:
        raise CannotSee("no HOME_POSITION")
    off = abs(home.latitude * 1e-7 - position.lat_deg) * 111_000.0
    return f"{answer}, {'here' if off < 5.0 else 'elsewhere'}"


def _set_home(s: Subject, lower_m: float, north_m: float = 0.0) -> str:
    """DO_SET_HOME to a place so far north of home, so much lower than the ground there; as often
    as it takes an estimator that has just been switched on.
    """
    place = (*s.place(north_m, 0.0), s.home_amsl_m - lower_m)
    end_s = s.client.t_s + _READY_S
    while True:
        answer = s.client.command_int(
            mavlink.MAV_CMD_DO_SET_HOME, place=place, frame=mavlink.MAV_FRAME_GLOBAL
        )
        if answer != "FAILED" or s.is_armed or s.client.t_s > end_s:
            return answer
        s.client.collect(2.0)


def _home_lower(s: Subject) -> Finding:
    """How much relative_alt grows when home is set 20 m lower; then home is put back."""
    before = s.position().rel_m
    ground_m = s.home_amsl_m
    answer = _set_home(s, _LOWER_M)
    s.client.collect(1.5)
    after = s.position().rel_m
    _put_home_back(s, ground_m)
    return Finding(round(after - before, 1), answer)


def _home_lower_on_mission(s: Subject) -> Finding:
    """How far it climbs or sinks (AMSL) in a mission when home is set 20 m lower, within 12 s."""
    fly_straight(s)
    ground_m, before_m = s.home_amsl_m, s.position().amsl_m
    answer = _set_home(s, _LOWER_M)
    s.client.collect(12.0)
    after_m = s.position().amsl_m
    _put_home_back(s, ground_m)
    return Finding(round(after_m - before_m, 1), answer)


def _home_far(s: Subject) -> str:
    ground_m = s.home_amsl_m
    answer = _set_home(s, 0.0, north_m=_FAR_M)
    s.client.collect(0.5)
    _put_home_back(s, ground_m)
    return answer


def _put_home_back(s: Subject, ground_m: float) -> None:
    place = (*s.place(0.0, 0.0), ground_m)
    s.client.command_int(mavlink.MAV_CMD_DO_SET_HOME, place=place, frame=mavlink.MAV_FRAME_GLOBAL)
    s.client.collect(1.5)


def _stranger_changes_mode(s: Subject) -> str:
    """DO_SET_MODE to RTL by another station, in the holding mode in the air."""
    with s.client.appearing_as(_STRANGER):
        s.client.beat()
        answer = s.set_mode("RTL")
        s.client.until(lambda: s.mode == "RTL", 3.0)
    return f"{answer}, {'changed' if s.mode == 'RTL' else 'as it was'}"


def _stranger_disarms(s: Subject) -> str:
    """A plain disarm by another station, of what we armed on the ground."""
    s.arm()
    with s.client.appearing_as(_STRANGER):
        s.client.beat()
        answer = s.disarm_once()
        s.client.until(lambda: not s.is_armed, 3.0)
    return f"{answer}, {'armed' if s.is_armed else 'disarmed'}"


def _stranger_uploads(s: Subject) -> str:
    """A list of the same length by another station, in flight: the list that is aboard after it."""
    fly_straight(s)
    theirs = [waypoint(s, 0.0, _THEIRS_M + 40.0 * n, 20.0) for n in range(3)]
    with s.client.appearing_as(_STRANGER):
        s.client.beat()
        answer = s.upload(theirs).ack
    stored = missions.download(s.client)
    east_deg = s.place(0.0, _THEIRS_M)[1]
    theirs_aboard = bool(stored) and abs(stored[s.first_seq()].y * 1e-7 - east_deg) < 1e-5
    return f"{answer}, {'theirs' if theirs_aboard else 'ours'}"


def _stranger_edits(s: Subject) -> str:
    """One item written anew by another station (a partial write), in flight."""
    fly_straight(s)
    with s.client.appearing_as(_STRANGER):
        s.client.beat()
        done = missions.write_partial(s.client, s.first_seq() + 2, [waypoint(s, 0.0, _THEIRS_M)])
    stored = missions.download(s.client)
    east_deg = s.place(0.0, _THEIRS_M)[1]
    theirs = stored is not None and abs(stored[-1].y * 1e-7 - east_deg) < 1e-5
    return f"{done.ack}, {'theirs' if theirs else 'ours'}"


BEHAVIOURS = (
    Behaviour(
        "rc_override/seen", "An override of the ground station is in RC_CHANNELS", _override_seen
    ),
    Behaviour(
        "rc_override/stranger",
        "An override of another system is in RC_CHANNELS",
        _override_by_stranger,
    ),
    Behaviour(
        "rc_override/sticks",
        "A stick moved in the holding mode changes",
        _sticks_in_hold,
        Where.AIR,
    ),
    Behaviour(
        "rc_override/joystick",
        "MANUAL_CONTROL moved in the holding mode changes",
        _joystick_in_hold,
        Where.AIR,
    ),
    Behaviour(
        "foreign/heartbeat", "With a companion on its link HEARTBEAT goes on", _companion_beats
    ),
    Behaviour("foreign/echo", "A link hears its own companion's HEARTBEAT back", _foreign_text),
    Behaviour("foreign/command", "A companion's command is", _command_from_companion),
    Behaviour("foreign/timesync", "TIMESYNC: it", _timesync),
    Behaviour("foreign/ping", "PING is answered", _ping),
    Behaviour("parcel/gripper_open", "DO_GRIPPER, open, is", partial(_gripper, 0.0)),
    Behaviour("parcel/gripper_close", "DO_GRIPPER, close, is", partial(_gripper, 1.0)),
    Behaviour(
        "parcel/servo", "DO_SET_SERVO is", _command(mavlink.MAV_CMD_DO_SET_SERVO, 9.0, 1700.0)
    ),
    Behaviour(
        "parcel/actuator", "DO_SET_ACTUATOR is", _command(mavlink.MAV_CMD_DO_SET_ACTUATOR, 0.0)
    ),
    Behaviour("parcel/winch", "DO_WINCH is", _command(mavlink.MAV_CMD_DO_WINCH, 1.0)),
    Behaviour("fence/enable", "DO_FENCE_ENABLE is", _fence_enable),
    Behaviour("acks/offboard", "OFFBOARD without set-points, disarmed, is", _offboard_ack),
    Behaviour("acks/speed_type", "DO_CHANGE_SPEED of type 77 is", _speed_type_ack, Where.AIR),
    Behaviour("acks/set_home", "DO_SET_HOME to here is", _home_here),
    Behaviour("acks/roi", "DO_SET_ROI_NONE is", _command(mavlink.MAV_CMD_DO_SET_ROI_NONE)),
    Behaviour(
        "acks/yaw",
        "CONDITION_YAW in the air is",
        _command(mavlink.MAV_CMD_CONDITION_YAW, 90.0),
        Where.AIR,
    ),
    Behaviour(
        "acks/loiter",
        "NAV_LOITER_UNLIM in the air is",
        _command(mavlink.MAV_CMD_NAV_LOITER_UNLIM),
        Where.AIR,
    ),
    Behaviour(
        "home/lower_ground",
        "DO_SET_HOME 20 m lower, disarmed, raises relative_alt by",
        _home_lower,
        unit="m",
        within=1.0,
    ),
    Behaviour(
        "home/lower_air",
        "DO_SET_HOME 20 m lower in the air raises relative_alt by",
        _home_lower,
        Where.AIR,
        unit="m",
        within=1.5,
    ),
    Behaviour(
        "home/lower_mission",
        "DO_SET_HOME 20 m lower in a mission takes it up or down by",
        _home_lower_on_mission,
        Where.AIR,
        unit="m",
        within=3.0,
    ),
    Behaviour("home/far_ground", "DO_SET_HOME 3 km away, disarmed, is", _home_far),
    Behaviour("home/far_air", "DO_SET_HOME 3 km away in the air is", _home_far, Where.AIR),
    Behaviour("stranger/disarm", "A disarm by another station is", _stranger_disarms),
    Behaviour("stranger/mode", "RTL by another station is", _stranger_changes_mode, Where.AIR),
    Behaviour(
        "stranger/upload",
        "A list by another station in flight, as long as ours, is",
        _stranger_uploads,
        Where.AIR,
    ),
    Behaviour(
        "stranger/edit",
        "An item by another station in flight is",
        _stranger_edits,
        Where.AIR,
    ),
)
