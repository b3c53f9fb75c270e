"""Telemetry: default messages, messages on request, and the meaning of fields."""

import math
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviour, Behaviours, Observation
from sim_bridge.conform.client import NO_RESPONSE, message_id
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.subject import WORKING_HZ, Subject, observed_once

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_CENSUS_S = 8.0
_DEFAULT_MESSAGES = (
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
_REQUESTED_HZ = 20.0
_GCS_TIMEOUT_S = 8.0


@observed_once
def _default_rates_hz(subject: Subject) -> dict[str, float]:
    """Measure message rates while the client requests nothing and sends only HEARTBEAT."""
    subject.restore_default_telemetry()
    for name in WORKING_HZ:  # an earlier client may have requested rates
        subject.client.request_message_interval(message_id(name), 0.0)
    subject.client.collect_messages(1.0)
    start_s = subject.client.t_s
    messages = subject.client.collect_messages(_CENSUS_S)
    window_s = subject.client.t_s - start_s
    names = [m.get_type() for m in messages]
    return {name: names.count(name) / window_s for name in set(names)}


def _default_rate_hz(message_name: str, subject: Subject) -> float:
    return round(_default_rates_hz(subject).get(message_name, 0.0), 2)


@behaviour("telemetry/silent_until_asked", "Almost no messages are sent before a request")
def _observe_silence_before_request(subject: Subject) -> Observation:
    """Observe whether almost no messages arrive before a request."""
    rates = _default_rates_hz(subject)
    total = sum(rates.values()) - rates.get("HEARTBEAT", 0.0)
    return Observation(total < 3.0, f"{total:.0f} messages a second without HEARTBEAT")


def _response_to_interval_request(message_name: str, subject: Subject) -> str:
    response = subject.request_stream(message_name, 2.0)
    subject.restore_stream(message_name)
    if message_name in WORKING_HZ:
        subject.request_stream(message_name, WORKING_HZ[message_name])
    return response


def _attitude_rate_hz(subject: Subject, duration_s: float) -> float:
    subject.client.collect_messages(0.5)
    start_s = subject.client.t_s
    count = len(subject.client.collect_messages(duration_s, "ATTITUDE"))
    return round(count / (subject.client.t_s - start_s), 1)


def _restore_attitude_stream(subject: Subject) -> None:
    subject.request_stream("ATTITUDE", WORKING_HZ["ATTITUDE"])


@behaviour(
    "telemetry/asked_rate",
    f"ATTITUDE asked at {_REQUESTED_HZ:.0f} Hz comes at",
    unit="Hz",
    within_frac=0.1,
)
def _measure_requested_rate_hz(subject: Subject) -> float:
    subject.request_stream("ATTITUDE", _REQUESTED_HZ)
    rate = _attitude_rate_hz(subject, 5.0)
    _restore_attitude_stream(subject)
    return rate


@behaviour("telemetry/stopped_rate", "ATTITUDE with interval -1 comes at", unit="Hz", within=0.4)
def _measure_rate_after_stop_hz(subject: Subject) -> float:
    subject.client.request_message_interval(message_id("ATTITUDE"), -1.0)
    rate = _attitude_rate_hz(subject, 3.0)
    _restore_attitude_stream(subject)
    return rate


@behaviour("telemetry/interval_told", "GET_MESSAGE_INTERVAL at 10 Hz reports")
def _observe_reported_interval(subject: Subject) -> Observation:
    subject.request_stream("ATTITUDE", 10.0)
    response = subject.client.send_command_and_wait_ack(
        mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, message_id("ATTITUDE")
    )
    interval = subject.client.latest.get("MESSAGE_INTERVAL")
    _restore_attitude_stream(subject)
    return Observation(
        "nothing" if interval is None else f"{interval.interval_us} us", f"answer: {response}"
    )


@behaviour(
    "telemetry/data_stream",
    "REQUEST_DATA_STREAM for EXTRA1 at 8 Hz gives ATTITUDE at",
    unit="Hz",
    within=1.0,
)
def _measure_data_stream_rate_hz(subject: Subject) -> float:
    """ATTITUDE by MAV_DATA_STREAM_EXTRA1 at 8 Hz."""
    subject.client.request_message_interval(message_id("ATTITUDE"), -1.0)
    _send_data_stream_request(subject, 8, 1)
    rate = _attitude_rate_hz(subject, 4.0)
    _send_data_stream_request(subject, 8, 0)
    _restore_attitude_stream(subject)
    return rate


def _send_data_stream_request(subject: Subject, rate_hz: int, start_stop: int) -> None:
    subject.client.send(
        "REQUEST_DATA_STREAM",
        req_stream_id=mavlink.MAV_DATA_STREAM_EXTRA1,
        req_message_rate=rate_hz,
        start_stop=start_stop,
    )


def _observe_single_message_request(message_name: str, subject: Subject) -> str:
    response = subject.client.request_message(message_name)
    is_received = subject.client.wait_until(
        lambda: subject.client.received_messages(message_name), 1.5
    )
    return f"{response}, {'sent' if is_received else 'not sent'}"


@behaviour("telemetry/heading_unit", "GLOBAL_POSITION_INT.hdg is in")
def _classify_heading_unit(subject: Subject) -> str:
    position = subject.client.wait_next_message("GLOBAL_POSITION_INT", 5.0)
    attitude = subject.client.wait_next_message("ATTITUDE", 5.0)
    if position is None or attitude is None:
        raise ObservationError("no GLOBAL_POSITION_INT or no ATTITUDE")
    yaw_deg = math.degrees(attitude.yaw) % 360.0
    for word, factor in (("centidegrees", 0.01), ("degrees", 1.0)):
        off = (position.hdg * factor - yaw_deg + 180.0) % 360.0 - 180.0
        if abs(off) < 3.0:
            return word
    return "neither"


def _provoke_refusal_texts(subject: Subject) -> list[str]:
    """Provoke a refusal with a text: the mission mode without a mission, or arming in it."""
    subject.client.clear_received()
    if subject.request_mode(subject.dialect.mission) == "ACCEPTED":
        subject.request_arm()
    subject.client.collect_messages(2.0)
    texts = subject.client.status_texts()
    subject.request_mode(subject.dialect.hold)
    return texts


@behaviour("telemetry/text_needs_gcs", "A refusal is sent as STATUSTEXT")
def _observe_text_without_gcs(subject: Subject) -> str:
    """Observe whether a refusal is sent as text on a link without a ground station."""
    with subject.client.use_identity(subject.client.companion):
        subject.client.collect_messages(_GCS_TIMEOUT_S)
        texts_without_gcs = _provoke_refusal_texts(subject)
    subject.client.collect_messages(3.0)
    texts_with_gcs = _provoke_refusal_texts(subject)
    if not texts_with_gcs:
        return "never"
    return "always" if texts_without_gcs else "only where a ground station is heard"


@behaviour("telemetry/text_end", "A STATUSTEXT ends")
def _classify_text_end(subject: Subject) -> Observation:
    texts = _provoke_refusal_texts(subject)
    if not texts:
        raise ObservationError("no STATUSTEXT received")
    tabs = sum(text.endswith("\t") for text in texts)
    word = "with a tab" if tabs == len(texts) else "some with a tab" if tabs else "plainly"
    return Observation(word, "; ".join(repr(text) for text in texts))


@behaviour(
    "telemetry/heartbeat_lag",
    "HEARTBEAT lags an accepted mode change by up to",
    unit="s",
    within=0.6,
)
def _measure_heartbeat_lag_s(subject: Subject) -> Observation:
    """The longest of some delays from an accepted mode change to the HEARTBEAT that shows it."""
    modes = ["RTL", subject.dialect.hold] if subject.is_px4 else ["STABILIZE", "GUIDED"]
    lags: list[float] = []
    for turn, mode in enumerate(modes * 3):
        subject.client.collect_messages(0.37 * turn)
        if subject.request_mode(mode) != "ACCEPTED":
            raise ObservationError(f"mode {mode} is refused")
        start_s = subject.client.t_s
        if not subject.client.wait_until(lambda mode=mode: subject.mode == mode, 4.0):
            raise ObservationError(f"HEARTBEAT never shows {mode}")
        lags.append(subject.client.t_s - start_s)
    return Observation(round(max(lags), 2), "of " + ", ".join(f"{lag:.2f}" for lag in lags))


def high_latency_field_value(subject: Subject, field_name: str) -> float:
    """Return a field of HIGH_LATENCY2, requested by any available method."""
    subject.client.request_message("HIGH_LATENCY2")
    message = subject.client.wait_next_message("HIGH_LATENCY2", 2.0)
    if message is None:
        subject.request_stream("HIGH_LATENCY2", 1.0)
        message = subject.client.wait_next_message("HIGH_LATENCY2", 6.0)
        subject.restore_stream("HIGH_LATENCY2")
    if message is None:
        raise ObservationError("no HIGH_LATENCY2 received")
    return getattr(message, field_name)


@behaviour("telemetry/high_latency_mode", "HIGH_LATENCY2.custom_mode is")
def _classify_high_latency_mode(subject: Subject) -> str:
    packed = int(high_latency_field_value(subject, "custom_mode"))
    custom = subject.client.latest["HEARTBEAT"].custom_mode
    if packed == custom & 0xFFFF:
        return "HEARTBEAT's"
    if packed == custom >> 16:
        return "HEARTBEAT's upper half"
    return "packed otherwise"


@behaviour("telemetry/boot_clock", "SYSTEM_TIME and ATTITUDE have clocks")
def _compare_boot_clocks(subject: Subject) -> str:
    """Compare the time since boot in SYSTEM_TIME with ATTITUDE."""
    subject.request_stream("SYSTEM_TIME", 4.0)
    time = subject.client.wait_next_message("SYSTEM_TIME", 3.0)
    attitude = subject.client.wait_next_message("ATTITUDE", 3.0)
    subject.restore_stream("SYSTEM_TIME")
    if time is None or attitude is None:
        return NO_RESPONSE
    return "the same" if abs(time.time_boot_ms - attitude.time_boot_ms) < 1500 else "another"


BEHAVIOURS.extend(
    Behaviour(
        f"telemetry/unasked_{name.lower()}",
        f"{name} is sent by default at",
        partial(_default_rate_hz, name),
        unit="Hz",
        within=0.2,
        within_frac=0.15,
    )
    for name in _DEFAULT_MESSAGES
)
BEHAVIOURS.extend(
    Behaviour(
        f"telemetry/interval_{name.lower()}",
        f"SET_MESSAGE_INTERVAL for {name} is",
        partial(_response_to_interval_request, name),
    )
    for name in _REQUESTED
)
BEHAVIOURS.extend(
    Behaviour(
        f"telemetry/{word}_on_request",
        f"REQUEST_MESSAGE for {name} is",
        partial(_observe_single_message_request, name),
    )
    for word, name in (("version", "AUTOPILOT_VERSION"), ("wind", "WIND"))
)
