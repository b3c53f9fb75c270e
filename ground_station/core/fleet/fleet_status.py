"""The fleet's status now: who is alive, what each member last reported, and what is doubtful.

Silence is counted on the desk's own clock; the vehicles' clocks are only shown. A doubtful vehicle
(two companions of one name, an impossible battery) gets no new work until a person has looked at
it. It can always be recalled.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.core.pilot.transitions import FLIGHT_PHASES, GROUND_PHASES
from companion.core.vehicle.airframe import Airframe
from companion.fleet.messages import State
from ground_station.core.fleet.truck_state import TRUCK

SILENT_S = 5.0
"""States come every second: after so many are missed a vehicle is called silent."""

STANDBY = "standby"
BEFORE_TAKE_OFF = frozenset(phase.value for phase in GROUND_PHASES)
IN_THE_AIR = frozenset(phase.value for phase in FLIGHT_PHASES)
RISE_FRAC = 0.02
"""Energy left is an estimate: it may rise in flight by this share of the pack, not by more."""

OVER_FRAC = 1.05
CELL_V = (2.0, 4.5)
"""Voltages of a lithium cell: a reading outside is not of a pack of this airframe."""

CLOCK_OFF_S = 5.0


@dataclass(slots=True)
class VehicleStatus:
    """One vehicle. `doubts` are the reasons why it gets no new work."""

    vehicle: str
    lives: set[str] = field(default_factory=set)
    state: State | None = None
    heard_s: float | None = None
    doubts: list[str] = field(default_factory=list)
    clock_off_s: float = 0.0

    def silent_s(self, t_s: float) -> float | None:
        """Seconds since its last state; None: there was none."""
        return None if self.heard_s is None else t_s - self.heard_s

    def present(self, t_s: float) -> bool:
        """Exactly one companion of this name is alive, and its states arrive."""
        silent_s = self.silent_s(t_s)
        return len(self.lives) == 1 and silent_s is not None and silent_s <= SILENT_S

    def has_left(self, life: str) -> bool:
        """A life that is not on the network while the one that spoke last is: its states are old
        ones, played again.
        """
        before = self.state
        return before is not None and before.life in self.lives and life not in self.lives

    def free(self, t_s: float) -> bool:
        """It may be given work."""
        state = self.state
        idle = state is not None and state.phase == STANDBY and not state.armed
        return self.present(t_s) and idle and not self.doubts


@dataclass(slots=True)
class FleetStatus:
    """All vehicles of a fleet. `airframes` by name: what their batteries can hold."""

    airframes: Mapping[str, Airframe] = field(default_factory=dict)
    vehicles: dict[str, VehicleStatus] = field(default_factory=dict)

    def of(self, vehicle: str) -> VehicleStatus:
        """The status of a vehicle, heard or not."""
        return self.vehicles.setdefault(vehicle, VehicleStatus(vehicle))

    def charge_frac_at_rest(self, vehicle: str) -> float | None:
        """Its charge by its resting voltage; None where that is not known, or it is armed."""
        state = self.of(vehicle).state
        airframe = self.airframes.get(state.airframe) if state is not None else None
        if state is None or airframe is None or not state.voltage_v or state.armed is not False:
            return None
        return airframe.battery.charge_frac_at_rest(state.voltage_v)

    def on_liveliness(self, vehicle: str, life: str, *, up: bool) -> str | None:
        """A life has joined or left the network; returns what the operator should be told."""
        seen = self.of(vehicle)
        (seen.lives.add if up else seen.lives.discard)(life)
        twins = "two companions announce themselves as it"
        if len(seen.lives) > 1 and twins not in seen.doubts:
            seen.doubts.append(twins)
            return f"{vehicle}: {twins}: no new work for it"
        if len(seen.lives) == 1 and twins in seen.doubts:
            seen.doubts.remove(twins)
            return f"{vehicle}: one companion again"
        return None

    def on_state(self, state: State, t_s: float, epoch_us: int) -> list[str]:
        """Take a state; returns new doubts about the vehicle, in words."""
        seen = self.of(state.vehicle)
        if seen.has_left(state.life):
            return []
        said = [f"{state.vehicle}: {doubt}" for doubt in self._doubts(seen.state, state)]
        seen.doubts += [doubt.partition(": ")[2] for doubt in said]
        before = seen.state
        if before is None or before.life != state.life or before.uptime_s <= state.uptime_s:
            seen.state, seen.heard_s = state, t_s
        off_s = (state.epoch_us - epoch_us) / 1e6
        if abs(off_s) > CLOCK_OFF_S >= abs(seen.clock_off_s):
            said.append(f"{state.vehicle}: its clock is off by {off_s:.0f} s (nothing rests on it)")
        seen.clock_off_s = off_s
        return said

    def _doubts(self, before: State | None, state: State) -> list[str]:
        known = self.of(state.vehicle).doubts
        found: list[str] = []
        airframe = self.airframes.get(state.airframe)
        if self.airframes and airframe is None and state.airframe != TRUCK:
            found.append(f"airframe {state.airframe} is not in the day's fleet")
        if airframe is not None:
            found += _battery_doubts(airframe, state)
        if before is not None and before.life == state.life and before.airframe != state.airframe:
            found.append("changed its airframe without a restart")
        if airframe is not None and _rose(before, state, airframe.battery.nominal_wh):
            found.append("its energy rose in flight")
        return [doubt for doubt in found if doubt not in known]


def _battery_doubts(airframe: Airframe, state: State) -> list[str]:
    battery = airframe.battery
    found: list[str] = []
    left_wh, voltage_v = state.energy_left_wh, state.voltage_v
    if left_wh is not None and left_wh > OVER_FRAC * battery.nominal_wh:
        found.append(f"reports more energy than its pack of {battery.nominal_wh:g} Wh holds")
    low_v, high_v = (battery.cells * v for v in CELL_V)
    if voltage_v is not None and voltage_v > 0.0 and not low_v <= voltage_v <= high_v:
        found.append(f"reports a voltage that no pack of {battery.cells} cells has")
    return found


def _rose(before: State | None, state: State, nominal_wh: float) -> bool:
    if before is None or before.assignment != state.assignment or not state.assignment:
        return False
    if not (before.armed and state.armed):
        return False
    if before.energy_left_wh is None or state.energy_left_wh is None:
        return False
    return state.energy_left_wh - before.energy_left_wh > RISE_FRAC * nominal_wh
