"""Wind and airspeed fields of a vehicle with default parameters, in the hover and on the move."""

import math
from typing import cast

from sim_bridge.conform.behaviour import Behaviour, Finding, Where
from sim_bridge.conform.behaviours.telemetry import high_latency
from sim_bridge.conform.client import Message
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.subject import Subject

_AS_GROUND_MPS = 0.4


def _wind(s: Subject) -> Finding:
    """ArduPilot's WIND."""
    s.stream("WIND", 4.0)
    message = s.client.hear("WIND", 3.0)
    s.unstream("WIND")
    if message is None:
        return Finding("never sent")
    told = f"direction {message.direction:.0f}, speed {message.speed:.1f}"
    return Finding("sent: no estimate" if message.speed == 0.0 else "sent: an estimate", told)


def _wind_cov(s: Subject) -> str:
    """WIND_COV, asked at 2 Hz."""
    s.stream("WIND_COV", 2.0)
    message = s.client.hear("WIND_COV", 4.0)
    s.unstream("WIND_COV")
    return "never sent" if message is None else "sent"


def _no_estimate_direction(s: Subject) -> str:
    s.stream("WIND", 4.0)
    message = s.client.hear("WIND", 3.0)
    s.unstream("WIND")
    return "never sent" if message is None else f"{message.direction:.0f} deg"


def _moving(s: Subject) -> list[tuple[Message, Message]]:
    """VFR_HUD with the LOCAL_POSITION_NED at its time, flying and climbing 40 m away."""

    def look() -> list[tuple[Message, Message]]:
        s.go_to(40.0, 0.0, 20.0)
        s.client.forget()
        s.go_to(0.0, 0.0, 20.0)
        pairs, local = [], None
        for message in s.client.heard:
            if message.get_type() == "LOCAL_POSITION_NED":
                local = message
            elif message.get_type() == "VFR_HUD" and local is not None:
                pairs.append((message, local))
        return pairs

    return cast(list[tuple[Message, Message]], s.remember("VFR_HUD on the move", look))


def _hud_airspeed(s: Subject) -> Finding:
    pairs = [(hud, v) for hud, v in _moving(s) if math.hypot(v.vx, v.vy) > 2.0]
    if len(pairs) < 5:
        raise CannotSee("it did not get above 2 m/s")
    speeds = [hud.airspeed for hud, _ in pairs]
    if all(math.isnan(speed) for speed in speeds):
        return Finding("NaN")
    off = max(abs(h.airspeed - math.sqrt(v.vx**2 + v.vy**2 + v.vz**2)) for h, v in pairs)
    note = f"at most {off:.2f} m/s from the velocity over ground"
    return Finding("the velocity over ground" if off < 1.0 else "something else", note)


def _hud_airspeed_hover(s: Subject) -> Finding:
    hud = s.client.hear("VFR_HUD", 3.0)
    if hud is None:
        raise CannotSee("no VFR_HUD")
    if math.isnan(hud.airspeed):
        return Finding("NaN")
    return Finding(
        "about 0" if abs(hud.airspeed) < _AS_GROUND_MPS else "above 0", f"{hud.airspeed:.2f} m/s"
    )


def _high_latency_airspeed(s: Subject) -> Finding:
    """On the move, where it differs from 0 if it means anything."""
    s.go_to(45.0, 0.0, 20.0)
    s.client.command_int(192, -1.0, 1.0, 0.0, math.nan, place=_there(s, -45.0), frame=0)
    s.client.collect(4.0)
    value = high_latency(s, "airspeed")
    return Finding("0" if value == 0 else "told", f"{value * 0.2:.1f} m/s")


def _there(s: Subject, north_m: float) -> tuple[float, float, float]:
    return (*s.place(north_m, 0.0), s.home_amsl_m + 20.0)


def _high_latency_wind(s: Subject) -> Finding:
    value = high_latency(s, "windspeed")
    return Finding("0" if value == 0 else "told", f"{value * 0.2:.1f} m/s")


BEHAVIOURS = (
    Behaviour("wind/wind", "WIND, asked for, is", _wind, Where.AIR),
    Behaviour(
        "wind/direction", "WIND.direction without an estimate is", _no_estimate_direction, Where.AIR
    ),
    Behaviour("wind/wind_cov", "WIND_COV, asked for, is", _wind_cov, Where.AIR),
    Behaviour(
        "wind/airspeed_hover", "VFR_HUD.airspeed in the hover is", _hud_airspeed_hover, Where.AIR
    ),
    Behaviour("wind/airspeed_moving", "VFR_HUD.airspeed on the move is", _hud_airspeed, Where.AIR),
    Behaviour(
        "wind/high_latency_airspeed",
        "HIGH_LATENCY2.airspeed on the move is",
        _high_latency_airspeed,
        Where.AIR,
    ),
    Behaviour(
        "wind/high_latency_wind", "HIGH_LATENCY2.windspeed is", _high_latency_wind, Where.AIR
    ),
)
