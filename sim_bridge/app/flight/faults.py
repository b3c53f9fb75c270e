"""Faults of flight files. Each starts once, when its vehicle reaches the named phase and time."""

import functools
import math
from collections.abc import Callable, Iterator

import numpy as np

from sim_bridge.app.flight.scenario import Fault, FaultKind
from sim_bridge.app.flight.stage import FaultContext, FaultScript
from sim_bridge.app.link.bad_link import FaultyLink
from sim_bridge.app.link.forger import Forger
from sim_bridge.app.world.flight_phase import FlightPhase, parse_file_phase

MISSION_JUMP_MESSAGES = frozenset({("MISSION_SET_CURRENT", 0), ("COMMAND_LONG", 224)})
ARMING_MESSAGES = frozenset({("COMMAND_LONG", 400)})
ATTITUDE_ERROR_RAD = math.radians(12.0)

FaultAction = Callable[[FaultContext, Fault], None]


def _no_action(context: FaultContext, fault: Fault) -> None:
    """Do nothing: the fault is permanent or ends without an action."""


def _actions_that_set_and_clear_attribute(
    owner: Callable[[FaultContext], object], attribute_name: str
) -> tuple[FaultAction, FaultAction]:
    """Return actions that set an attribute of the simulated world to True, then to False."""
    return (
        lambda context, fault: setattr(owner(context), attribute_name, True),
        lambda context, fault: setattr(owner(context), attribute_name, False),
    )


def _actions_that_refuse_and_accept_messages(
    message_ids: frozenset[tuple[str, int]],
) -> tuple[FaultAction, FaultAction]:
    """Return actions: the autopilot refuses these messages, then accepts them."""

    def start_refusal(context: FaultContext, fault: Fault) -> None:
        context.craft.link.refused |= message_ids

    def stop_refusal(context: FaultContext, fault: Fault) -> None:
        context.craft.link.refused -= message_ids

    return start_refusal, stop_refusal


def _silence_link(context: FaultContext, fault: Fault) -> None:
    context.craft.link.silent_until_s = context.t_s + (fault.duration_s or 1e9)


def _start_faulty_link(context: FaultContext, fault: Fault) -> None:
    craft = context.craft
    craft.link.bad_link = FaultyLink(craft.number, np.random.default_rng(len(craft.record.rows)))


def _start_forger(context: FaultContext, fault: Fault) -> None:
    context.craft.link.forger = Forger(context.craft.number, context.craft.autopilot_kind)


def _restart_companion_if_requested(context: FaultContext, fault: Fault) -> None:
    if fault.restart:
        context.restart_companion()


FAULT_ACTIONS: dict[FaultKind, tuple[FaultAction, FaultAction]] = {
    "link_silent": (_silence_link, _no_action),
    "companion_kill": (
        lambda context, fault: context.kill_companion(),
        _restart_companion_if_requested,
    ),
    "companion_stall": (
        lambda context, fault: context.stall_companion(),
        lambda context, fault: context.resume_companion(),
    ),
    "disk_full": (
        lambda context, fault: context.craft.companion.simulate_full_disk(),
        lambda context, fault: context.craft.companion.end_simulated_full_disk(),
    ),
    "autopilot_reboot": (lambda context, fault: context.craft.autopilot.reboot(), _no_action),
    "gnss_lost": _actions_that_set_and_clear_attribute(
        lambda context: context.craft.vehicle.sensors, "gnss_outage"
    ),
    "pitot_stuck": _actions_that_set_and_clear_attribute(
        lambda context: context.craft.vehicle.sensors, "pitot_stuck"
    ),
    "release_fails": _actions_that_set_and_clear_attribute(
        lambda context: context.craft.vehicle, "release_fails"
    ),
    "attitude_wrong": (
        lambda context, fault: context.craft.vehicle.sensors.add_attitude_bias(ATTITUDE_ERROR_RAD),
        _no_action,
    ),
    "pilot_takes_over": (lambda context, fault: context.craft.start_pilot_override(), _no_action),
    "ground_takes_over": (
        lambda context, fault: context.craft.command_rtl_from_ground_station(),
        _no_action,
    ),
    "bad_link": (
        _start_faulty_link,
        lambda context, fault: setattr(context.craft.link, "bad_link", None),
    ),
    "forger": (_start_forger, lambda context, fault: setattr(context.craft.link, "forger", None)),
    "clock_jump": (
        lambda context, fault: context.craft.autopilot.shift_message_clock(fault.by_s),
        _no_action,
    ),
    "jumps_refused": _actions_that_refuse_and_accept_messages(MISSION_JUMP_MESSAGES),
    "arming_refused": _actions_that_refuse_and_accept_messages(ARMING_MESSAGES),
    "home_moves": (lambda context, fault: context.craft.request_landing_stop(fault.to), _no_action),
}
"""Start and end action of each kind."""


def build_fault_scripts(faults: list[Fault], vehicle_count: int) -> list[FaultScript]:
    """Return scripts for a flight file's faults."""
    return [
        FaultScript(
            functools.partial(_wait_for_and_apply_fault, fault=fault),
            FlightPhase.CLIMB if fault.phase is None else parse_file_phase(fault.phase),
            np.random.default_rng(0),
            fault.vehicle,
        )
        for fault in faults
        if fault.vehicle <= vehicle_count
    ]


def _wait_for_and_apply_fault(context: FaultContext, fault: Fault) -> Iterator[None]:
    craft, (begin, end) = context.craft, FAULT_ACTIONS[fault.kind]
    if fault.phase is None:
        yield from context.wait_until(lambda: craft.record.takeoff_s is not None)
        from_s = craft.record.takeoff_s or 0.0
    else:
        yield from context.wait_until(lambda: craft.true_flight_phase is context.phase)
        from_s = context.t_s
    yield from context.wait_until(lambda: context.t_s >= from_s + fault.at_s)
    ends_s = context.t_s + fault.duration_s
    craft.started_faults.append((context.t_s, fault.kind))
    begin(context, fault)
    if fault.duration_s > 0.0 or fault.kind == "companion_kill":
        yield
        yield from context.wait_until(lambda: context.t_s >= ends_s)
        end(context, fault)
