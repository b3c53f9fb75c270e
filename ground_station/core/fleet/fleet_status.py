"""What the desk knows of its vehicles now: who lives, what each last said, and what is doubtful.

Silence is counted on the desk's own clock; the vehicles' clocks are only shown. A vehicle that is
doubtful (two companions of one name, a battery that cannot be) gets no new work until a person has
looked; it can always be recalled.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.core.vehicle.airframe import Airframe
from companion.fleet.messages import State
from ground_station.core.fleet.truck_state import TRUCK

SILENT_S = 5.0
"""States come every second: after so many are missed a vehicle is called silent."""

STANDBY = "standby"
RISE_FRAC = 0.02
"""Energy left may wander by this share of the pack in flight: it is an estimate; it never rises."""

OVER_FRAC = 1.05
CELL_V = (2.0, 4.5)
"""Outside of any lithium cell's voltage: no reading of a pack of this airframe."""

CLOCK_OFF_S = 5.0


@dataclass(slots=True)
class VehicleSeen:
    """One vehicle. `doubts` are the reasons why it gets no new work."""

    vehicle: str
    lives: set[str] = field(default_factory=set)
    state: State | None = None
    heard_s: float | None = None
    doubts: list[str] = field(default_factory=list)
    clock_off_s: float = 0.0

    def silent_s(self, t_s: float) -> float | None:
        """Since when it has said nothing; `None`: it never has."""
        return None if self.heard_s is None else t_s - self.heard_s

    def present(self, t_s: float) -> bool:
        """One companion lives, and has just been heard."""
        silent_s = self.silent_s(t_s)
        return len(self.lives) == 1 and silent_s is not None and silent_s <= SILENT_S

    def free(self, t_s: float) -> bool:
        """It may be given work."""
        state = self.state
        idle = state is not None and state.phase == STANDBY and not state.armed
        return self.present(t_s) and idle and not self.doubts


@dataclass(slots=True)
class Picture:
    """All vehicles of a fleet. `airframes` by name: what their batteries can hold."""

    airframes: Mapping[str, Airframe] = field(default_factory=dict)
    vehicles: dict[str, VehicleSeen] = field(default_factory=dict)

    def of(self, vehicle: str) -> VehicleSeen:
        """What is known of a vehicle."""
        return self.vehicles.setdefault(vehicle, VehicleSeen(vehicle))

    def alive(self, vehicle: str, life: str, *, up: bool) -> str | None:
        """A life came or went; returns what is to be said about it."""
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

    def hear(self, state: State, t_s: float, epoch_us: int) -> list[str]:
        """Take a state; returns new doubts about it, in words."""
        seen = self.of(state.vehicle)
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
        found.append(f"tells more energy than its pack of {battery.nominal_wh:g} Wh holds")
    low_v, high_v = (battery.cells * v for v in CELL_V)
    if voltage_v is not None and voltage_v > 0.0 and not low_v <= voltage_v <= high_v:
        found.append(f"tells a voltage that no pack of {battery.cells} cells has")
    return found


def _rose(before: State | None, state: State, nominal_wh: float) -> bool:
    if before is None or before.assignment != state.assignment or not state.assignment:
        return False
    if not (before.armed and state.armed):
        return False
    if before.energy_left_wh is None or state.energy_left_wh is None:
        return False
    return state.energy_left_wh - before.energy_left_wh > RISE_FRAC * nominal_wh
