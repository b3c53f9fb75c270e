"""The people of a simulated day who handle drones on the ground, and those of a depot.

Positions are NED metres about the day's depot.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from companion.app.flight.fleet_port import STANDBY
from companion.core.pilot.transitions import GROUND_PHASES, Phase
from companion.fleet.messages import State
from sim_bridge.app.day.clock import EPOCH_US
from sim_bridge.app.day.drone import BY_HAND_AFTER_S, DayDrone
from sim_bridge.app.day.truck import ON_PAD_M, Drive, DriverTask

STANDS_RADIUS_M = 21.0
"""Drones stand on a ring about the depot, six of them 21 m apart, so that two may climb and descend
at once (`ground_station.core.deconfliction.pads`); a desk takes 30 m for being there."""

EVERY_S = 0.5
"""They look so often; a companion takes seconds from its assignment until it is ready."""

BEFORE_ARMING = frozenset({STANDBY, *(p.value for p in GROUND_PHASES if p is not Phase.ARM)})
"""What a companion tells while hands may be on its drone."""

FETCH_MPS = 3.0
"""People fetch a drone that is down elsewhere: through fields on foot, or around them by car."""

NOTICED_S = 30.0
"""A drone that is down and tells nothing is fetched after so long beyond `BY_HAND_AFTER_S`."""


class GroundCrew(Protocol):
    """Who puts drones out, loads parcels, fetches what is down; a truck's driver or a depot's."""

    drives: list[Drive]
    done: list[DriverTask]
    delivered: list[tuple[float, str]]
    """When which order was handed over by the crew itself."""

    def turn(self, t_s: float) -> None:
        """Do what is due now."""
        ...

    @property
    def at_rest(self) -> bool:
        """Whether nothing is asked of them."""
        ...

    def close(self) -> None:
        """The day is over."""
        ...


@dataclass(slots=True)
class DepotCrew:
    """Two hands for each drone of a depot without a truck.

    A drone waits at its stand, switched on with a fresh pack. Somebody stands beside it who reads
    the desk's screen: the parcel is on it as soon as it has taken an assignment, for with
    `--auto-launch` the desk waits for nobody. What has flown is switched off where it is down and
    is back at its stand, with another pack, `change_s` and the way later. No drone flies twice on
    one pack. `states`: what drones tell, by name. `gone`: by order, whether its parcel was gone
    from the drone that was fetched.
    """

    drones: list[DayDrone]
    payload_kg: Mapping[str, float]
    states: Mapping[str, State]
    change_s: float
    drives: list[Drive] = field(default_factory=list)
    done: list[DriverTask] = field(default_factory=list)
    delivered: list[tuple[float, str]] = field(default_factory=list)
    gone: dict[str, bool] = field(default_factory=dict)
    _back_s: dict[str, float] = field(default_factory=dict)
    """When each drone that is switched off stands at its stand again."""
    _due_s: float = 0.0

    @property
    def at_rest(self) -> bool:
        """Nobody asks anything of them: what they do follows from the drones."""
        return True

    def close(self) -> None:
        """Nothing is open."""

    def turn(self, t_s: float) -> None:
        """Look after each drone."""
        if t_s < self._due_s:
            return
        self._due_s = t_s + EVERY_S - 0.05
        for number, drone in enumerate(self.drones):
            if drone.up is None:
                self._put_out(drone, number, t_s)
            elif not drone.is_airborne and not drone.up.vehicle.is_crashed:
                self._mind(drone, t_s)

    def _put_out(self, drone: DayDrone, number: int, t_s: float) -> None:
        if t_s >= self._back_s.get(drone.name, 0.0):
            drone.switch_on(t_s, self._stand_ne_m(number), 0.0, None)

    def _stand_ne_m(self, number: int) -> tuple[float, float]:
        angle_rad = 2.0 * math.pi * number / len(self.drones)
        return STANDS_RADIUS_M * math.cos(angle_rad), STANDS_RADIUS_M * math.sin(angle_rad)

    def _mind(self, drone: DayDrone, t_s: float) -> None:
        assert drone.up is not None
        state = self._told_since(drone, drone.up.t0_s)
        if drone.wants_a_hand(t_s) and drone.standing_at(
            t_s, (0.0, 0.0), STANDS_RADIUS_M + ON_PAD_M
        ):
            drone.disarm()
        if drone.grounded_s(t_s) > 0.0:
            if self._is_over(drone, state, t_s):
                self._fetch(drone, t_s)
        elif state is not None and state.phase in BEFORE_ARMING and state.order != drone.up.order:
            drone.load(self.payload_kg.get(state.order or "", 0.0), state.order)
            self.gone.pop(state.order or "", None)

    def _told_since(self, drone: DayDrone, since_s: float) -> State | None:
        """Its newest state, if it is of this time at its stand."""
        state = self.states.get(drone.name)
        wall_off_us = round(drone.wall_off_s * 1e6)
        if state is None or state.epoch_us - wall_off_us - EPOCH_US < since_s * 1e6:
            return None
        return state

    def _is_over(self, drone: DayDrone, state: State | None, t_s: float) -> bool:
        """It is down and says that its flight is over, or has been down and silent for long."""
        assert drone.up is not None
        if not drone.standing_at(t_s, drone.up.vehicle.pos_ned_m[:2], ON_PAD_M):
            return False
        told = drone.companion is not None and state is not None and state.phase == STANDBY
        return told or drone.grounded_s(t_s) > BY_HAND_AFTER_S + NOTICED_S

    def _fetch(self, drone: DayDrone, t_s: float) -> None:
        assert drone.up is not None
        away_m = math.hypot(*drone.up.vehicle.pos_ned_m[:2])
        way_s = 0.0 if away_m <= ON_PAD_M else 2.0 * away_m / FETCH_MPS
        self._back_s[drone.name] = t_s + way_s + self.change_s
        if drone.up.order is not None:
            self.gone[drone.up.order] = not drone.carries_parcel
        self.done.append(DriverTask("fetch", "depot", drone.up.order, drone.name, t_s, t_s + way_s))
        drone.switch_off()
