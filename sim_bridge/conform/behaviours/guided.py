"""Reposition and set-points: frames, speeds, time-outs, and acknowledgements without effect."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviour, Finding, Where
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.subject import HEIGHT_M, Subject

_REPOSITION = mavlink.MAV_CMD_DO_REPOSITION
_UP_M = 5.0
_VELOCITY_ONLY = 0b110111000111
_POSITION_ONLY = 0b110111111000
_SPEED_MPS = 3.0


def _reposition_long(s: Subject) -> str:
    """A COMMAND_LONG to here, 5 m higher by AMSL."""
    here = s.position()
    up = here.amsl_m + _UP_M
    answer = s.client.command(_REPOSITION, -1.0, 1.0, 0.0, math.nan, here.lat_deg, here.lon_deg, up)
    went = s.client.until(lambda: _climb(s) > 0.4, 5.0)
    return f"{answer}, {'flown' if went else 'not flown'}"


def _climb(s: Subject) -> float:
    return -s.client.latest["GLOBAL_POSITION_INT"].vz * 0.01


def _reposition_relative(s: Subject) -> Finding:
    """Frame 6, 5 m higher than now above home: climbing obeys the frame, sinking takes AMSL."""
    if s.home_amsl_m < 2.0 * _UP_M:
        raise CannotSee(f"home is at {s.home_amsl_m:.1f} m AMSL: no telling one from the other")
    here = s.position()
    asked_m = here.rel_m + _UP_M
    place = (here.lat_deg, here.lon_deg, asked_m)
    answer = s.client.command_int(_REPOSITION, -1.0, 1.0, 0.0, math.nan, place=place, frame=6)
    s.client.collect(1.0)
    moved = s.client.until(lambda: abs(_climb(s)) > 0.5, 6.0)
    rises = _climb(s) > 0.0
    s.set_mode(s.dialect.hold)
    word = "obeyed" if rises else "ignored: AMSL"
    return Finding(f"{answer}, {word if moved else 'no movement'}", f"{asked_m:.0f} m asked")


def _reposition_speed(s: Subject) -> Finding:
    """60 m at 2 m/s."""
    lat, lon = s.place(60.0, 0.0)
    place = (lat, lon, s.home_amsl_m + HEIGHT_M)
    s.client.command_int(_REPOSITION, 2.0, 1.0, 0.0, math.nan, place=place, frame=0)
    s.client.collect(4.0)
    heard = s.client.collect(4.0, "GLOBAL_POSITION_INT")
    fastest = max(math.hypot(m.vx, m.vy) * 0.01 for m in heard)
    if fastest < 1.0:
        raise CannotSee("it did not move")
    return Finding("obeyed" if fastest < 2.8 else "ignored", f"{fastest:.1f} m/s")


def _reposition_on_ground(s: Subject) -> str:
    lat, lon = s.place(30.0, 0.0)
    place = (lat, lon, s.home_amsl_m + HEIGHT_M)
    return s.client.command_int(_REPOSITION, -1.0, 1.0, 0.0, math.nan, place=place, frame=0)


def _reposition_without_flag(s: Subject) -> str:
    """In another mode, and not told to change it."""
    s.enter("RTL")
    lat, lon = s.place(30.0, 0.0)
    place = (lat, lon, s.home_amsl_m + HEIGHT_M)
    answer = s.client.command_int(_REPOSITION, -1.0, 0.0, 0.0, math.nan, place=place, frame=0)
    s.client.collect(1.5)
    return f"{answer}, {s.mode}"


def _velocity(s: Subject, north_mps: float) -> None:
    _local_setpoint(s, _VELOCITY_ONLY, vx=north_mps)


def _local_setpoint(s: Subject, type_mask: int, **told: float) -> None:
    """One set-point in LOCAL_NED; what is not given is 0."""
    fields = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    s.client.send(
        "SET_POSITION_TARGET_LOCAL_NED",
        time_boot_ms=0,
        coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
        type_mask=type_mask,
        **(dict.fromkeys(fields, 0.0) | told),
    )


def _fly_velocity(s: Subject, for_s: float) -> None:
    """Set-points at about 10 Hz; the mode for them is entered after the first second."""
    end_s = s.client.t_s + for_s
    asked = s.mode == s.dialect.guided
    start_s = s.client.t_s
    while s.client.t_s < end_s:
        _velocity(s, _SPEED_MPS)
        s.client.collect(0.1)
        if not asked and s.client.t_s - start_s > 1.0:
            asked = True
            mode = s.dialect.mode_params(s.dialect.guided)
            s.client.say_command(mavlink.MAV_CMD_DO_SET_MODE, *mode)


def _north_mps(s: Subject) -> float:
    return s.client.latest["GLOBAL_POSITION_INT"].vx * 0.01


def _velocity_flown(s: Subject) -> float:
    _fly_velocity(s, 9.0)
    return round(_north_mps(s), 1)


_TIME_OUTS = {"px4": ("COM_OF_LOSS_T", 1.0), "ardupilot": ("GUID_TIMEOUT", 3.0)}
"""Their defaults; PX4's SITL lengthens its own by the speed-up."""


def _velocity_stops(s: Subject) -> Finding:
    """The set-points stop: what the mode is 8 s later, and when it had slowed down."""
    with s.parameter_set(*_TIME_OUTS[s.dialect.name]):
        slowed_s = _slowing(s)
        s.client.collect(max(8.0 - slowed_s, 0.5))
        word = "halts" if slowed_s < _ENDLESS_S else "flies on"
        return Finding(f"{word}, {s.mode}", f"slowing after {slowed_s:.1f} s")


_ENDLESS_S = 12.0


def _slowing(s: Subject) -> float:
    """From the last velocity set-point to 60 % of its speed."""
    _fly_velocity(s, 9.0)
    start_s = s.client.t_s
    s.client.until(lambda: _north_mps(s) < 0.6 * _SPEED_MPS, _ENDLESS_S)
    return s.client.t_s - start_s


def _velocity_patience(s: Subject) -> float:
    with s.parameter_set(*_TIME_OUTS[s.dialect.name]):
        return round(_slowing(s), 1)


def _setpoints_elsewhere(s: Subject) -> str:
    """Velocity set-points while the vehicle returns."""
    s.enter("RTL")
    s.client.collect(1.0)
    end_s = s.client.t_s + 4.0
    while s.client.t_s < end_s:
        _velocity(s, _SPEED_MPS)
        s.client.collect(0.1)
    return f"{'obeyed' if _north_mps(s) > 1.5 else 'ignored'}, {s.mode}"


def _guided_in_air(s: Subject) -> str:
    """The mode for set-points, asked for without any."""
    answer = s.set_mode(s.dialect.guided)
    s.client.collect(3.0)
    return f"{answer}, {s.mode}"


def _position_setpoint(s: Subject) -> Finding:
    """LOCAL_NED 15 m north of the origin and 20 m above it."""
    start_s, asked = s.client.t_s, s.mode == s.dialect.guided
    while s.client.t_s < start_s + 14.0:
        _local_setpoint(s, _POSITION_ONLY, x=15.0, z=-HEIGHT_M)
        s.client.collect(0.2)
        if not asked and s.client.t_s - start_s > 1.0:
            asked = True
            s.set_mode(s.dialect.guided)
    local = s.client.latest.get("LOCAL_POSITION_NED")
    if local is None:
        raise CannotSee("no LOCAL_POSITION_NED")
    off = math.dist((local.x, local.y, local.z), (15.0, 0.0, -HEIGHT_M))
    return Finding("reached" if off < 2.5 else "not reached", f"{off:.1f} m off")


BEHAVIOURS = (
    Behaviour("guided/reposition_ground", "DO_REPOSITION while disarmed is", _reposition_on_ground),
    Behaviour(
        "guided/reposition_long", "DO_REPOSITION as COMMAND_LONG is", _reposition_long, Where.AIR
    ),
    Behaviour(
        "guided/reposition_frame", "DO_REPOSITION in frame 6 is", _reposition_relative, Where.AIR
    ),
    Behaviour("guided/reposition_speed", "DO_REPOSITION's speed is", _reposition_speed, Where.AIR),
    Behaviour(
        "guided/reposition_flag",
        "DO_REPOSITION in RTL, mode not to be changed, is",
        _reposition_without_flag,
        Where.AIR,
    ),
    Behaviour(
        "guided/entered_without",
        "The mode for set-points without any is",
        _guided_in_air,
        Where.AIR,
    ),
    Behaviour(
        "guided/velocity",
        f"A velocity of {_SPEED_MPS:g} m/s is flown at",
        _velocity_flown,
        Where.AIR,
        unit="m/s",
        within=0.5,
    ),
    Behaviour(
        "guided/velocity_stops", "When velocity set-points stop, it", _velocity_stops, Where.AIR
    ),
    Behaviour(
        "guided/velocity_patience",
        "After the last velocity set-point it slows down within",
        _velocity_patience,
        Where.AIR,
        unit="s",
        within=1.0,
    ),
    Behaviour(
        "guided/position", "A position set-point in LOCAL_NED is", _position_setpoint, Where.AIR
    ),
    Behaviour("guided/elsewhere", "Set-points in RTL are", _setpoints_elsewhere, Where.AIR),
)
