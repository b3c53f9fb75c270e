"""Wind and airspeed fields of a vehicle with default parameters, in the hover and on the move."""

import math

from sim_bridge.conform.behaviour import AIR, Behaviours, Observation
from sim_bridge.conform.behaviours.telemetry import high_latency_field_value
from sim_bridge.conform.client import Message
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.subject import Subject, observed_once

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_AS_GROUND_MPS = 0.4


def _request_once(subject: Subject, name: str, rate_hz: float, timeout_s: float) -> Message | None:
    subject.request_stream(name, rate_hz)
    message = subject.client.wait_next_message(name, timeout_s)
    subject.restore_stream(name)
    return message


@behaviour("wind/wind", "WIND, asked for, is", AIR)
def _observe_requested_wind(subject: Subject) -> Observation:
    """ArduPilot's WIND."""
    message = _request_once(subject, "WIND", 4.0, 3.0)
    if message is None:
        return Observation("never sent")
    wind_text = f"direction {message.direction:.0f}, speed {message.speed:.1f}"
    return Observation(
        "sent: no estimate" if message.speed == 0.0 else "sent: an estimate", wind_text
    )


@behaviour("wind/wind_cov", "WIND_COV, asked for, is", AIR)
def _observe_requested_wind_cov(subject: Subject) -> str:
    """Return WIND_COV, requested at 2 Hz."""
    return "never sent" if _request_once(subject, "WIND_COV", 2.0, 4.0) is None else "sent"


@behaviour("wind/direction", "WIND.direction without an estimate is", AIR)
def _wind_direction_without_estimate(subject: Subject) -> str:
    message = _request_once(subject, "WIND", 4.0, 3.0)
    return "never sent" if message is None else f"{message.direction:.0f} deg"


@observed_once
def _moving_hud_and_position_pairs(subject: Subject) -> list[tuple[Message, Message]]:
    """VFR_HUD with the LOCAL_POSITION_NED at its time, flying and climbing 40 m away."""
    subject.fly_to_and_wait(40.0)
    subject.client.clear_received()
    subject.fly_to_and_wait(0.0)
    pairs, local = [], None
    for message in subject.client.received:
        if message.get_type() == "LOCAL_POSITION_NED":
            local = message
        elif message.get_type() == "VFR_HUD" and local is not None:
            pairs.append((message, local))
    return pairs


@behaviour("wind/airspeed_moving", "VFR_HUD.airspeed on the move is", AIR)
def _classify_moving_hud_airspeed(subject: Subject) -> Observation:
    pairs = [
        (hud, v)
        for hud, v in _moving_hud_and_position_pairs(subject)
        if math.hypot(v.vx, v.vy) > 2.0
    ]
    if len(pairs) < 5:
        raise ObservationError("it did not get above 2 m/s")
    speeds = [hud.airspeed for hud, _ in pairs]
    if all(math.isnan(speed) for speed in speeds):
        return Observation("NaN")
    off = max(abs(h.airspeed - math.sqrt(v.vx**2 + v.vy**2 + v.vz**2)) for h, v in pairs)
    note = f"at most {off:.2f} m/s from the velocity over ground"
    return Observation("the velocity over ground" if off < 1.0 else "something else", note)


@behaviour("wind/airspeed_hover", "VFR_HUD.airspeed in the hover is", AIR)
def _classify_hover_hud_airspeed(subject: Subject) -> Observation:
    hud = subject.client.wait_next_message("VFR_HUD", 3.0)
    if hud is None:
        raise ObservationError("no VFR_HUD")
    if math.isnan(hud.airspeed):
        return Observation("NaN")
    return Observation(
        "about 0" if abs(hud.airspeed) < _AS_GROUND_MPS else "above 0", f"{hud.airspeed:.2f} m/s"
    )


@behaviour("wind/high_latency_airspeed", "HIGH_LATENCY2.airspeed on the move is", AIR)
def _observe_high_latency_airspeed(subject: Subject) -> Observation:
    """Return HIGH_LATENCY2.airspeed in motion, where a valid value differs from 0."""
    subject.fly_to_and_wait(45.0)
    subject.request_reposition(-45.0)
    subject.client.collect_messages(4.0)
    value = high_latency_field_value(subject, "airspeed")
    return Observation("0" if value == 0 else "told", f"{value * 0.2:.1f} m/s")


@behaviour("wind/high_latency_wind", "HIGH_LATENCY2.windspeed is", AIR)
def _observe_high_latency_windspeed(subject: Subject) -> Observation:
    value = high_latency_field_value(subject, "windspeed")
    return Observation("0" if value == 0 else "told", f"{value * 0.2:.1f} m/s")
