"""Telemetry: what comes unasked, what can be asked for, and what the fields mean."""

import math
from functools import partial
from typing import cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviour, Finding
from sim_bridge.conform.client import NO_ANSWER
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.subject import WORKING_HZ, Subject, message_id

_CENSUS_S = 8.0
_UNASKED = (
    "HEARTBEAT",
    "ATTITUDE",
    "GLOBAL_POSITION_INT",
    "LOCAL_POSITION_NED",
    "VFR_HUD",
    "SYS_STATUS",
    "BATTERY_STATUS",
    "EXTENDED_SYS_STATE",
    "HOME_POSITION",
    "GPS_RAW_INT",
    "MISSION_CURRENT",
    "SYSTEM_TIME",
)
_REQUESTED = (
    "WIND",
    "WIND_COV",
    "AIRSPEED",
    "BATTERY_STATUS",
    "HIGH_LATENCY2",
    "EXTENDED_SYS_STATE",
    "HOME_POSITION",
    "ALTITUDE",
    "ESTIMATOR_STATUS",
    "CURRENT_MODE",
    "MISSION_CURRENT",
    "EKF_STATUS_REPORT",
)
_ASKED_HZ = 20.0
_GCS_FORGOTTEN_S = 8.0


def _census(s: Subject) -> dict[str, float]:
    """Rates of what comes while nothing is asked, and nothing but HEARTBEAT is sent."""

    def look() -> dict[str, float]:
        s.see_as_found()
        for name in WORKING_HZ:  # whoever was here before may have asked
            s.client.ask_interval(message_id(name), 0.0)
        s.client.collect(1.0)
        start_s = s.client.t_s
        heard = s.client.collect(_CENSUS_S)
        window_s = s.client.t_s - start_s
        names = [m.get_type() for m in heard]
        return {name: names.count(name) / window_s for name in set(names)}

    return cast(dict[str, float], s.remember("census", look))


def _unasked_rate(name: str, s: Subject) -> float:
    return round(_census(s).get(name, 0.0), 2)


def _is_silent(s: Subject) -> Finding:
    """Whether hardly anything comes until asked."""
    others = {name: rate for name, rate in _census(s).items() if name != "HEARTBEAT"}
    total = sum(others.values())
    return Finding(total < 3.0, f"{total:.0f} messages a second beside HEARTBEAT")


def _interval_answer(name: str, s: Subject) -> str:
    answer = s.stream(name, 2.0)
    s.unstream(name)
    if name in WORKING_HZ:
        s.stream(name, WORKING_HZ[name])
    return answer


def _asked_rate(s: Subject) -> float:
    s.stream("ATTITUDE", _ASKED_HZ)
    s.client.collect(0.5)
    start_s = s.client.t_s
    count = len(s.client.collect(5.0, "ATTITUDE"))
    rate = count / (s.client.t_s - start_s)
    s.stream("ATTITUDE", WORKING_HZ["ATTITUDE"])
    return round(rate, 1)


def _stopped(s: Subject) -> float:
    s.client.ask_interval(message_id("ATTITUDE"), -1.0)
    s.client.collect(0.5)
    count = len(s.client.collect(3.0, "ATTITUDE"))
    s.stream("ATTITUDE", WORKING_HZ["ATTITUDE"])
    return count / 3.0


def _interval_told(s: Subject) -> Finding:
    s.stream("ATTITUDE", 10.0)
    answer = s.client.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, message_id("ATTITUDE"))
    told = s.client.latest.get("MESSAGE_INTERVAL")
    s.stream("ATTITUDE", WORKING_HZ["ATTITUDE"])
    return Finding("nothing" if told is None else f"{told.interval_us} us", f"answer: {answer}")


def _data_stream(s: Subject) -> float:
    """ATTITUDE by MAV_DATA_STREAM_EXTRA1 at 8 Hz."""
    s.client.ask_interval(message_id("ATTITUDE"), -1.0)
    _request_stream(s, 8, 1)
    s.client.collect(0.5)
    start_s = s.client.t_s
    rate = len(s.client.collect(4.0, "ATTITUDE")) / (s.client.t_s - start_s)
    _request_stream(s, 8, 0)
    s.stream("ATTITUDE", WORKING_HZ["ATTITUDE"])
    return round(rate, 1)


def _request_stream(s: Subject, rate_hz: int, start: int) -> None:
    s.client.send(
        "REQUEST_DATA_STREAM",
        req_stream_id=mavlink.MAV_DATA_STREAM_EXTRA1,
        req_message_rate=rate_hz,
        start_stop=start,
    )


def _once(name: str, s: Subject) -> str:
    answer = s.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id(name))
    came = s.client.until(lambda: any(m.get_type() == name for m in s.client.heard), 1.5)
    return f"{answer}, {'sent' if came else 'not sent'}"


def _heading_unit(s: Subject) -> str:
    position = s.client.hear("GLOBAL_POSITION_INT", 5.0)
    attitude = s.client.hear("ATTITUDE", 5.0)
    if position is None or attitude is None:
        raise CannotSee("no GLOBAL_POSITION_INT or no ATTITUDE")
    yaw_deg = math.degrees(attitude.yaw) % 360.0
    for word, factor in (("centidegrees", 0.01), ("degrees", 1.0)):
        off = (position.hdg * factor - yaw_deg + 180.0) % 360.0 - 180.0
        if abs(off) < 3.0:
            return word
    return "neither"


def _provoke_text(s: Subject) -> list[str]:
    """Ask for what is refused with words: the mission mode without a mission, or arming in it."""
    s.client.forget()
    if s.set_mode(s.dialect.mission) == "ACCEPTED":
        s.arm_once()
    s.client.collect(2.0)
    said = s.client.texts()
    s.set_mode(s.dialect.hold)
    return said


def _text_without_gcs(s: Subject) -> str:
    """Whether a refusal is put into words on a link where no ground station is."""
    with s.client.appearing_as(s.client.companion):
        s.client.collect(_GCS_FORGOTTEN_S)
        alone = _provoke_text(s)
    s.client.collect(3.0)
    together = _provoke_text(s)
    if not together:
        return "never"
    return "always" if alone else "only where a ground station is heard"


def _text_end(s: Subject) -> Finding:
    said = _provoke_text(s)
    if not said:
        raise CannotSee("no STATUSTEXT came")
    tabs = sum(text.endswith("\t") for text in said)
    word = "with a tab" if tabs == len(said) else "some with a tab" if tabs else "plainly"
    return Finding(word, "; ".join(repr(text) for text in said))


def _heartbeat_lag(s: Subject) -> Finding:
    """The longest of some delays from an accepted mode change to the HEARTBEAT that shows it."""
    modes = ["RTL", s.dialect.hold] if s.is_px4 else ["STABILIZE", "GUIDED"]
    lags: list[float] = []
    for turn, mode in enumerate(modes * 3):
        s.client.collect(0.37 * turn)
        if s.set_mode(mode) != "ACCEPTED":
            raise CannotSee(f"mode {mode} is refused")
        start_s = s.client.t_s
        if not s.client.until(lambda mode=mode: s.mode == mode, 4.0):
            raise CannotSee(f"HEARTBEAT never shows {mode}")
        lags.append(s.client.t_s - start_s)
    return Finding(round(max(lags), 2), "of " + ", ".join(f"{lag:.2f}" for lag in lags))


def high_latency(s: Subject, field: str) -> float:
    """A field of HIGH_LATENCY2, by whichever way it is sent."""
    s.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id("HIGH_LATENCY2"))
    message = s.client.hear("HIGH_LATENCY2", 2.0)
    if message is None:
        s.stream("HIGH_LATENCY2", 1.0)
        message = s.client.hear("HIGH_LATENCY2", 6.0)
        s.unstream("HIGH_LATENCY2")
    if message is None:
        raise CannotSee("no HIGH_LATENCY2 comes")
    return getattr(message, field)


def _high_latency_mode(s: Subject) -> str:
    packed = int(high_latency(s, "custom_mode"))
    custom = s.client.latest["HEARTBEAT"].custom_mode
    if packed == custom & 0xFFFF:
        return "HEARTBEAT's"
    if packed == custom >> 16:
        return "HEARTBEAT's upper half"
    return "packed otherwise"


def _system_time(s: Subject) -> str:
    """What SYSTEM_TIME says of the time since boot, against ATTITUDE."""
    s.stream("SYSTEM_TIME", 4.0)
    time = s.client.hear("SYSTEM_TIME", 3.0)
    attitude = s.client.hear("ATTITUDE", 3.0)
    s.unstream("SYSTEM_TIME")
    if time is None or attitude is None:
        return NO_ANSWER
    return "the same" if abs(time.time_boot_ms - attitude.time_boot_ms) < 1500 else "another"


BEHAVIOURS = (
    Behaviour("telemetry/silent_until_asked", "Hardly anything is sent until asked", _is_silent),
    *(
        Behaviour(
            f"telemetry/unasked_{name.lower()}",
            f"{name} comes unasked at",
            partial(_unasked_rate, name),
            unit="Hz",
            within=0.2,
            within_frac=0.15,
        )
        for name in _UNASKED
    ),
    *(
        Behaviour(
            f"telemetry/interval_{name.lower()}",
            f"SET_MESSAGE_INTERVAL for {name} is",
            partial(_interval_answer, name),
        )
        for name in _REQUESTED
    ),
    Behaviour(
        "telemetry/asked_rate",
        f"ATTITUDE asked at {_ASKED_HZ:.0f} Hz comes at",
        _asked_rate,
        unit="Hz",
        within_frac=0.1,
    ),
    Behaviour(
        "telemetry/stopped_rate",
        "ATTITUDE with interval -1 comes at",
        _stopped,
        unit="Hz",
        within=0.4,
    ),
    Behaviour("telemetry/interval_told", "GET_MESSAGE_INTERVAL at 10 Hz tells", _interval_told),
    Behaviour(
        "telemetry/data_stream",
        "REQUEST_DATA_STREAM for EXTRA1 at 8 Hz gives ATTITUDE at",
        _data_stream,
        unit="Hz",
        within=1.0,
    ),
    Behaviour(
        "telemetry/version_on_request",
        "REQUEST_MESSAGE for AUTOPILOT_VERSION is",
        partial(_once, "AUTOPILOT_VERSION"),
    ),
    Behaviour("telemetry/wind_on_request", "REQUEST_MESSAGE for WIND is", partial(_once, "WIND")),
    Behaviour("telemetry/heading_unit", "GLOBAL_POSITION_INT.hdg is in", _heading_unit),
    Behaviour("telemetry/boot_clock", "SYSTEM_TIME and ATTITUDE have clocks", _system_time),
    Behaviour("telemetry/text_needs_gcs", "A refusal is put into words", _text_without_gcs),
    Behaviour("telemetry/text_end", "A STATUSTEXT ends", _text_end),
    Behaviour(
        "telemetry/heartbeat_lag",
        "HEARTBEAT lags an accepted mode change by up to",
        _heartbeat_lag,
        unit="s",
        within=0.6,
    ),
    Behaviour("telemetry/high_latency_mode", "HIGH_LATENCY2.custom_mode is", _high_latency_mode),
)
