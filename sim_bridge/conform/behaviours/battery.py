"""Battery: which fields are known, and how they change in the hover."""

from collections.abc import Callable
from functools import partial

from sim_bridge.conform.behaviour import AIR, Behaviours, Observation, Value
from sim_bridge.conform.client import Message
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.subject import Subject, observed_once

_OBSERVATION_S = 8.0
_UNKNOWN_MV = 65535


@observed_once
def _hover_messages(subject: Subject) -> tuple[Message, Message, Message]:
    """Return the first and last BATTERY_STATUS during a hover, and the last SYS_STATUS."""
    messages = subject.client.collect_messages(_OBSERVATION_S, "BATTERY_STATUS")
    status = subject.client.latest.get("SYS_STATUS")
    if len(messages) < 2 or status is None:
        raise ObservationError("no BATTERY_STATUS or no SYS_STATUS")
    return messages[0], messages[-1], status


def _classify_voltages(_: Message, last: Message, status: Message) -> Observation:
    """Observe whether the first cell's field holds the voltage of the whole pack."""
    known = [mv for mv in last.voltages if mv != _UNKNOWN_MV]
    note = f"{last.voltages[:7]}, SYS_STATUS {status.voltage_battery} mV"
    if not known:
        return Observation("nothing", note)
    is_pack = abs(known[0] - status.voltage_battery) < 0.05 * status.voltage_battery
    if len(known) == 1 and is_pack:
        return Observation("the pack's in the first place", note)
    return Observation("each cell's", note)


def _classify_current(_: Message, last: Message, __: Message) -> Observation:
    known = last.current_battery != -1
    return Observation("known" if known else "-1", f"{last.current_battery * 0.01:.1f} A")


def _classify_counter_change(
    field: str, unit: str, first: Message, last: Message, _: Message
) -> Observation:
    before, after = getattr(first, field), getattr(last, field)
    unchanged = "stays at 0" if after == 0 else "stays"
    word = "-1" if max(before, after) < 0 else "grows" if after > before else unchanged
    return Observation(word, f"{before} to {after} {unit}")


def _classify_time_remaining(_: Message, last: Message, __: Message) -> Observation:
    return Observation("0" if last.time_remaining == 0 else "told", f"{last.time_remaining} s")


def _compare_shares(_: Message, last: Message, status: Message) -> Observation:
    difference_pct = abs(last.battery_remaining - status.battery_remaining)
    note = f"{last.battery_remaining} and {status.battery_remaining} %"
    return Observation("alike to 1 %" if difference_pct <= 1 else "apart", note)


BEHAVIOURS = Behaviours()


def _add(
    name: str, description: str, observe: Callable[[Message, Message, Message], Observation | Value]
) -> None:
    BEHAVIOURS.add(name, description, lambda subject: observe(*_hover_messages(subject)), AIR)


_consumed_mah = partial(_classify_counter_change, "current_consumed", "mAh")
_consumed_hj = partial(_classify_counter_change, "energy_consumed", "hJ")
_add("battery/voltages", "BATTERY_STATUS.voltages are", _classify_voltages)
_add("battery/current", "The current in the hover is", _classify_current)
_add("battery/current_consumed", "current_consumed in the hover", _consumed_mah)
_add("battery/energy_consumed", "energy_consumed in the hover", _consumed_hj)
_add("battery/time_remaining", "time_remaining is", _classify_time_remaining)
_add("battery/remaining_alike", "SYS_STATUS and BATTERY_STATUS give percentages", _compare_shares)
_add(
    "battery/remaining_known", "The percentage is known", lambda _, m, __: m.battery_remaining >= 0
)
