"""Reposition and set-points: frames, speeds, time-outs, and acknowledgements without effect."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import AIR, Behaviours, Observation
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.subject import HEIGHT_M, Subject

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_REPOSITION = mavlink.MAV_CMD_DO_REPOSITION
_UP_M = 5.0
_VELOCITY_ONLY = 0b110111000111
_POSITION_ONLY = 0b110111111000
_SPEED_MPS = 3.0


@behaviour("guided/reposition_long", "DO_REPOSITION as COMMAND_LONG is", AIR)
def _observe_reposition_by_command_long(subject: Subject) -> str:
    """A COMMAND_LONG to here, 5 m higher by AMSL."""
    here = subject.wait_position()
    up = here.amsl_m + _UP_M
    response = subject.client.send_command_and_wait_ack(
        _REPOSITION, -1.0, 1.0, 0.0, math.nan, here.lat_deg, here.lon_deg, up
    )
    has_moved = subject.client.wait_until(lambda: _climb_rate_mps(subject) > 0.4, 5.0)
    return f"{response}, {'flown' if has_moved else 'not flown'}"


def _climb_rate_mps(subject: Subject) -> float:
    return -subject.latest_position().vel_ned_mps[2]


@behaviour("guided/reposition_frame", "DO_REPOSITION in frame 6 is", AIR)
def _observe_reposition_in_relative_frame(subject: Subject) -> Observation:
    """Frame 6, 5 m higher than now above home: climbing obeys the frame, sinking takes AMSL."""
    if subject.home_amsl_m < 2.0 * _UP_M:
        raise ObservationError(
            f"home is at {subject.home_amsl_m:.1f} m AMSL: the two cannot be distinguished"
        )
    here = subject.wait_position()
    requested_m = here.rel_m + _UP_M
    target = (here.lat_deg, here.lon_deg, requested_m)
    response = subject.client.send_command_int_and_wait_ack(
        _REPOSITION, -1.0, 1.0, 0.0, math.nan, position=target, frame=6
    )
    subject.client.collect_messages(1.0)
    moved = subject.client.wait_until(lambda: abs(_climb_rate_mps(subject)) > 0.5, 6.0)
    rises = _climb_rate_mps(subject) > 0.0
    subject.request_mode(subject.dialect.hold)
    word = "obeyed" if rises else "ignored: AMSL"
    return Observation(
        f"{response}, {word if moved else 'no movement'}", f"{requested_m:.0f} m asked"
    )


@behaviour("guided/reposition_speed", "DO_REPOSITION's speed is", AIR)
def _observe_reposition_speed(subject: Subject) -> Observation:
    """60 m at 2 m/s."""
    subject.request_reposition(60.0, speed_mps=2.0)
    subject.client.collect_messages(4.0)
    messages = subject.client.collect_messages(4.0, "GLOBAL_POSITION_INT")
    fastest = max(math.hypot(m.vx, m.vy) * 0.01 for m in messages)
    if fastest < 1.0:
        raise ObservationError("it did not move")
    return Observation("obeyed" if fastest < 2.8 else "ignored", f"{fastest:.1f} m/s")


@behaviour("guided/reposition_ground", "DO_REPOSITION while disarmed is")
def _response_to_reposition_while_disarmed(subject: Subject) -> str:
    return subject.request_reposition(30.0)


@behaviour("guided/reposition_flag", "DO_REPOSITION in RTL, mode not to be changed, is", AIR)
def _observe_reposition_without_mode_flag(subject: Subject) -> str:
    """Send DO_REPOSITION in another mode, without the flag that changes the mode."""
    subject.set_mode_and_wait("RTL")
    response = subject.request_reposition(30.0, change_mode=False)
    subject.client.collect_messages(1.5)
    return f"{response}, {subject.mode}"


def _send_local_setpoint(subject: Subject, type_mask: int, **setpoint_fields: float) -> None:
    """Send one set-point in LOCAL_NED; omitted fields are 0."""
    fields = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    subject.client.send(
        "SET_POSITION_TARGET_LOCAL_NED",
        time_boot_ms=0,
        coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
        type_mask=type_mask,
        **(dict.fromkeys(fields, 0.0) | setpoint_fields),
    )


def _stream_setpoints(
    subject: Subject, duration_s: float, *, enter_mode: bool = True, **setpoint_fields: float
) -> None:
    """Set-points at about 10 Hz; the mode for them is entered after the first second."""
    start_s = subject.client.t_s
    is_guided = subject.mode == subject.dialect.guided or not enter_mode
    mask = _VELOCITY_ONLY if "vx" in setpoint_fields else _POSITION_ONLY
    while subject.client.t_s < start_s + duration_s:
        _send_local_setpoint(subject, mask, **setpoint_fields)
        subject.client.collect_messages(0.1)
        if not is_guided and subject.client.t_s - start_s > 1.0:
            is_guided = True
            mode = subject.dialect.do_set_mode_params(subject.dialect.guided)
            subject.client.send_command(mavlink.MAV_CMD_DO_SET_MODE, *mode)


def _north_speed_mps(subject: Subject) -> float:
    return subject.latest_position().vel_ned_mps[0]


@behaviour(
    "guided/velocity", f"A velocity of {_SPEED_MPS:g} m/s is flown at", AIR, unit="m/s", within=0.5
)
def _measure_flown_north_velocity_mps(subject: Subject) -> float:
    _stream_setpoints(subject, 9.0, vx=_SPEED_MPS)
    return round(_north_speed_mps(subject), 1)


_TIME_OUTS = {"px4": ("COM_OF_LOSS_T", 1.0), "ardupilot": ("GUID_TIMEOUT", 3.0)}
"""Their defaults; PX4's SITL lengthens its own by the speed-up."""


@behaviour("guided/velocity_stops", "When velocity set-points stop, it", AIR)
def _observe_end_of_velocity_setpoints(subject: Subject) -> Observation:
    """The set-points stop: what the mode is 8 s later, and when it had slowed down."""
    with subject.parameters.temporarily_set(*_TIME_OUTS[subject.dialect.name]):
        slowed_s = _measure_slowdown_time_s(subject)
        subject.client.collect_messages(max(8.0 - slowed_s, 0.5))
        word = "halts" if slowed_s < _ENDLESS_S else "flies on"
        return Observation(f"{word}, {subject.mode}", f"slowing after {slowed_s:.1f} s")


_ENDLESS_S = 12.0


def _measure_slowdown_time_s(subject: Subject) -> float:
    """Measure the time from the last velocity set-point to 60 % of its speed."""
    _stream_setpoints(subject, 9.0, vx=_SPEED_MPS)
    start_s = subject.client.t_s
    subject.client.wait_until(lambda: _north_speed_mps(subject) < 0.6 * _SPEED_MPS, _ENDLESS_S)
    return subject.client.t_s - start_s


@behaviour(
    "guided/velocity_patience",
    "After the last velocity set-point it slows down within",
    AIR,
    unit="s",
    within=1.0,
)
def _measure_setpoint_timeout_s(subject: Subject) -> float:
    with subject.parameters.temporarily_set(*_TIME_OUTS[subject.dialect.name]):
        return round(_measure_slowdown_time_s(subject), 1)


@behaviour("guided/elsewhere", "Set-points in RTL are", AIR)
def _observe_setpoints_in_rtl(subject: Subject) -> str:
    """Velocity set-points while the vehicle returns."""
    subject.set_mode_and_wait("RTL")
    subject.client.collect_messages(1.0)
    _stream_setpoints(subject, 4.0, enter_mode=False, vx=_SPEED_MPS)
    return f"{'obeyed' if _north_speed_mps(subject) > 1.5 else 'ignored'}, {subject.mode}"


@behaviour("guided/entered_without", "The mode for set-points without any is", AIR)
def _enter_guided_without_setpoints(subject: Subject) -> str:
    """Request the set-point mode in the air without sending set-points."""
    response = subject.request_mode(subject.dialect.guided)
    subject.client.collect_messages(3.0)
    return f"{response}, {subject.mode}"


@behaviour("guided/position", "A position set-point in LOCAL_NED is", AIR)
def _observe_position_setpoint_reached(subject: Subject) -> Observation:
    """LOCAL_NED 15 m north of the origin and 20 m above it."""
    _stream_setpoints(subject, 14.0, x=15.0, z=-HEIGHT_M)
    local = subject.client.latest.get("LOCAL_POSITION_NED")
    if local is None:
        raise ObservationError("no LOCAL_POSITION_NED")
    off = math.dist((local.x, local.y, local.z), (15.0, 0.0, -HEIGHT_M))
    return Observation("reached" if off < 2.5 else "not reached", f"{off:.1f} m off")
