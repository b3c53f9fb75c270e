"""Battery: which fields are known, and how they change in the hover."""

from typing import cast

from sim_bridge.conform.behaviour import Behaviour, Finding, Where
from sim_bridge.conform.client import Message
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.subject import Subject

_WATCHED_S = 8.0
_UNKNOWN_MV = 65535


def _watch(s: Subject) -> tuple[Message, Message, Message]:
    """First and last BATTERY_STATUS of a while in the hover, and the last SYS_STATUS."""

    def look() -> tuple[Message, Message, Message]:
        heard = s.client.collect(_WATCHED_S, "BATTERY_STATUS")
        status = s.client.latest.get("SYS_STATUS")
        if len(heard) < 2 or status is None:
            raise CannotSee("no BATTERY_STATUS or no SYS_STATUS")
        return heard[0], heard[-1], status

    return cast(tuple[Message, Message, Message], s.remember("battery in the hover", look))


def _voltages(s: Subject) -> Finding:
    """Whether the first cell's place holds the whole pack's voltage."""
    _, last, status = _watch(s)
    known = [mv for mv in last.voltages if mv != _UNKNOWN_MV]
    note = f"{last.voltages[:7]}, SYS_STATUS {status.voltage_battery} mV"
    if not known:
        return Finding("nothing", note)
    is_pack = abs(known[0] - status.voltage_battery) < 0.05 * status.voltage_battery
    if len(known) == 1 and is_pack:
        return Finding("the pack's in the first place", note)
    return Finding("each cell's", note)


def _current(s: Subject) -> Finding:
    _, last, _ = _watch(s)
    known = last.current_battery != -1
    return Finding("known" if known else "-1", f"{last.current_battery * 0.01:.1f} A")


def _run(first: float, last: float) -> str:
    if first < 0 and last < 0:
        return "-1"
    if last > first:
        return "grows"
    return "stays at 0" if last == 0 else "stays"


def _consumed(s: Subject) -> Finding:
    first, last, _ = _watch(s)
    note = f"{first.current_consumed} to {last.current_consumed} mAh"
    return Finding(_run(first.current_consumed, last.current_consumed), note)


def _energy(s: Subject) -> Finding:
    first, last, _ = _watch(s)
    note = f"{first.energy_consumed} to {last.energy_consumed} hJ"
    return Finding(_run(first.energy_consumed, last.energy_consumed), note)


def _time_remaining(s: Subject) -> Finding:
    _, last, _ = _watch(s)
    return Finding("0" if last.time_remaining == 0 else "told", f"{last.time_remaining} s")


def _remaining(s: Subject) -> Finding:
    _, last, status = _watch(s)
    apart = abs(last.battery_remaining - status.battery_remaining)
    note = f"{last.battery_remaining} and {status.battery_remaining} %"
    return Finding("alike to 1 %" if apart <= 1 else "apart", note)


def _remaining_known(s: Subject) -> bool:
    _, last, _ = _watch(s)
    return last.battery_remaining >= 0


BEHAVIOURS = (
    Behaviour("battery/voltages", "BATTERY_STATUS.voltages are", _voltages, Where.AIR),
    Behaviour("battery/current", "The current in the hover is", _current, Where.AIR),
    Behaviour("battery/current_consumed", "current_consumed in the hover", _consumed, Where.AIR),
    Behaviour("battery/energy_consumed", "energy_consumed in the hover", _energy, Where.AIR),
    Behaviour("battery/time_remaining", "time_remaining is", _time_remaining, Where.AIR),
    Behaviour("battery/remaining_known", "The percentage is known", _remaining_known, Where.AIR),
    Behaviour(
        "battery/remaining_alike",
        "SYS_STATUS and BATTERY_STATUS give percentages",
        _remaining,
        Where.AIR,
    ),
)
