"""Injected faults: each begins once, when its vehicle reaches the named phase and time."""

import math
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.app.flight.forger import Forger
from sim_bridge.app.flight.scenario import Fault
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.app.link.bad_link import BadLink

JUMPS = frozenset({("MISSION_SET_CURRENT", 0), ("COMMAND_LONG", 224)})
ARMING = frozenset({("COMMAND_LONG", 400)})
ATTITUDE_WRONG_RAD = math.radians(12.0)


@dataclass(slots=True)
class _Pending:
    fault: Fault
    phase_began_s: float | None = None
    begun: bool = False
    ends_s: float | None = None


@dataclass(slots=True)
class FaultPlan:
    """The faults of a run; `log` is what was injected, with its time."""

    faults: list[Fault]
    log: list[tuple[float, str]] = field(default_factory=list)
    _pending: list[_Pending] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._pending = [_Pending(fault) for fault in self.faults]

    def apply(self, crafts: list[Craft], t_s: float, lockstep: Lockstep) -> None:
        """Begin and end what is due at `t_s`."""
        for pending in self._pending:
            if pending.fault.vehicle > len(crafts):
                continue
            craft = crafts[pending.fault.vehicle - 1]
            if not pending.begun and self._due(pending, craft, t_s):
                pending.begun = True
                pending.ends_s = t_s + pending.fault.duration_s
                self.log.append((t_s, f"{pending.fault.kind} begins on vehicle {craft.number}"))
                _begin(pending.fault, craft, t_s, lockstep)
            elif pending.begun and pending.ends_s is not None and t_s >= pending.ends_s:
                pending.ends_s = None
                _end(pending.fault, craft)

    def end(self) -> None:
        """Nothing of a flight file's faults outlasts the run."""

    @staticmethod
    def _due(pending: _Pending, craft: Craft, t_s: float) -> bool:
        if pending.fault.phase is None:
            began = craft.record.took_off_s
        else:
            if pending.phase_began_s is None and craft.phase == pending.fault.phase:
                pending.phase_began_s = t_s
            began = pending.phase_began_s
        return began is not None and t_s >= began + pending.fault.at_s


def _begin(fault: Fault, craft: Craft, t_s: float, lockstep: Lockstep) -> None:
    match fault.kind:
        case "link_silent":
            craft.link_silent_until_s = t_s + (fault.duration_s or 1e9)
        case "companion_kill":
            craft.companion.kill()
            lockstep.lose(craft.number - 1)
        case "companion_stall":
            craft.companion.stall()
            lockstep.lose(craft.number - 1)
        case "disk_full":
            craft.companion.fill_disk()
        case "autopilot_reboot":
            craft.autopilot.reboot()
        case "gnss_lost":
            craft.vehicle.sensors.gnss_outage = True
        case "pitot_stuck":
            craft.vehicle.sensors.pitot_stuck = True
        case "attitude_wrong":
            craft.vehicle.sensors.knock(ATTITUDE_WRONG_RAD)
        case "release_fails":
            craft.vehicle.release_fails = True
        case "pilot_takes_over":
            craft.pilot_takes_over()
        case "ground_takes_over":
            craft.ground_takes_over()
        case "bad_link":
            rng = np.random.default_rng(len(craft.record.rows))
            craft.bad_link = BadLink(craft.number, rng)
        case "forger":
            craft.forger = Forger(craft.number, craft.autopilot_kind)
        case "clock_jump":
            craft.autopilot.jump_clock(fault.by_s)
        case "jumps_refused":
            craft.refused |= JUMPS
        case "arming_refused":
            craft.refused |= ARMING
        case "home_moves":
            craft.ask_home(fault.to)


def _end(fault: Fault, craft: Craft) -> None:
    if fault.duration_s == 0.0 and fault.kind != "companion_kill":
        return  # for good
    match fault.kind:
        case "companion_kill" if fault.restart:
            craft.companion.start()
            craft.companion_returns = True
        case "companion_stall":
            craft.companion.go_on()
            craft.companion_returns = True
        case "disk_full":
            craft.companion.empty_disk()
        case "gnss_lost":
            craft.vehicle.sensors.gnss_outage = False
        case "pitot_stuck":
            craft.vehicle.sensors.pitot_stuck = False
        case "release_fails":
            craft.vehicle.release_fails = False
        case "bad_link":
            craft.bad_link = None
        case "forger":
            craft.forger = None
        case "jumps_refused":
            craft.refused -= JUMPS
        case "arming_refused":
            craft.refused -= ARMING
        case _:
            return
