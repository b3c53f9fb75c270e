"""Pre-flight checks: which parameters, failsafes and batteries would break the promise.

Each autopilot's list of requirements is in its adapter; how they are judged is here.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from companion.core.vehicle.airframe import BatteryPack

Values = Mapping[str, float | None]

TAKEN_LEAST_M, TAKEN_MOST_M = 0.8, 3.0
"""How far off its height an item may count as reached: PX4's default, and the most."""


@dataclass(frozen=True, slots=True)
class RouteFacts:
    """What the autopilot's settings are judged against; heights above the depot."""

    highest_obstacle_m: float
    cruise_height_m: float
    farthest_m: float
    first_waypoint_m: float
    max_ground_mps: float
    max_tilt_deg: float
    climb_mps: float
    descent_mps: float
    landing_mps: float
    battery_cutoff_v: float
    battery_low_v: float
    battery_cells: int
    battery_capacity_mah: float
    carries_parcel: bool
    set_points: bool = False
    over_ground_m: float = 0.0
    """Clear of known ground, with the clearance; 0 where none is known."""
    room_m: float = math.inf
    """Above it begin geo-zones that the flight passes under, with the clearance."""
    slopes: bool = False
    """Whether waypoints that follow one another are at different heights."""

    @property
    def taken_within_m(self) -> float:
        """How far off its height an item may count as reached: what is sunk in two seconds.

        The hold over the drop, from there on, lasts WEIGH_S (5 s): the release is in height. A leg
        may begin so far below its height; plans keep 8 m more than the clearance.
        """
        return min(max(2.0 * self.descent_mps, TAKEN_LEAST_M), TAKEN_MOST_M)

    @property
    def rtl_height_m(self) -> float:
        """The least height at which a straight line home is clear of everything on the site."""
        built_m = self.highest_obstacle_m + 10.0 if self.highest_obstacle_m > 0.0 else 0.0
        return max(built_m, self.over_ground_m)

    @property
    def rtl_words(self) -> str:
        """What is asked of the height of an RTL."""
        words = f"an RTL above every obstacle and the ground ({self.rtl_height_m:.0f} m)"
        if math.isinf(self.room_m):
            return words
        return f"{words} and under geo-zones ({self.room_m:.0f} m)"

    def is_rtl_height(self, height_m: float) -> bool:
        """Tell whether an RTL at this height is clear of everything on the site."""
        return self.rtl_height_m <= height_m <= self.room_m


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the pre-flight. `blocks` = no take-off with it; `waits` = may pass by itself."""

    name: str
    words: str
    blocks: bool
    waits: bool = False


@dataclass(frozen=True, slots=True)
class Requirement:
    """Something that the promise asks of the autopilot's parameters.

    `names` are all that it reads. `holds` judges their values (`None`: cannot tell), `wanted` says
    what `--configure` would set. `required` = take-off is refused without it.
    """

    names: tuple[str, ...]
    words: str
    holds: Callable[[Values], bool | None]
    wanted: Callable[[Values], dict[str, float]]
    required: bool


def known(values: Values, name: str, test: Callable[[float], bool]) -> bool | None:
    """What a test says of a parameter's value; `None` where the autopilot does not tell it."""
    value = values.get(name)
    return None if value is None else bool(test(value))


CELL_SLACK_V = 0.1
"""A cell's voltage may be so far out of its table: sensor error, and a charge just ended."""


def pack_trouble(battery: BatteryPack, resting_v: float | None) -> str:
    """Say why the pack that is fitted cannot be the airframe's, or is empty; `""` when it may fly.

    `resting_v` is the whole pack's voltage while disarmed, `None` where nobody measures it.
    """
    if resting_v is None:
        return ""
    cell_v = resting_v / battery.cells
    empty_v, full_v = battery.ocv_cell_v[0], battery.ocv_cell_v[-1]
    if not empty_v - CELL_SLACK_V <= cell_v <= full_v + CELL_SLACK_V:
        return (
            f"{resting_v:.1f} V does not fit a pack of {battery.cells} cells"
            f" ({cell_v:.2f} V each; empty is {empty_v:g}, full is {full_v:g}):"
            " another pack, another airframe, or a dead one?"
        )
    if resting_v <= battery.low_v:
        return (
            f"the battery is empty: {resting_v:.1f} V at rest, {cell_v:.2f} V a cell"
            f" (low is {battery.low_v / battery.cells:.2f} in flight)"
        )
    return ""


def judge(requirements: Iterable[Requirement], values: Values) -> tuple[Finding, ...]:
    """Return what is missing or off, required things first."""
    found: list[Finding] = []
    for requirement in requirements:
        holds = requirement.holds(values)
        if holds:
            continue
        name = requirement.names[0]
        if holds is None:
            words = f"{requirement.words}: this autopilot tells no {name}"
        else:
            words = f"{requirement.words}: {_remedy(requirement, values)}"
        found.append(Finding(name, words, blocks=requirement.required))
    return tuple(sorted(found, key=lambda f: not f.blocks))


def _remedy(requirement: Requirement, values: Values) -> str:
    """What is set and what should be: `COM_LOW_BAT_ACT is 0, set 3`."""
    wanted = requirement.wanted(values)
    told = {n: v for n in requirement.names if (v := values.get(n)) is not None}
    return ", ".join(
        f"{name} is {value:g}" + (f", set {wanted[name]:g}" if name in wanted else "")
        for name, value in told.items()
        if wanted.get(name) != value
    )


def settings_wanted(requirements: Iterable[Requirement], values: Values) -> dict[str, float]:
    """Return what has to be set so that every requirement holds which can be told."""
    wanted: dict[str, float] = {}
    for requirement in requirements:
        if requirement.holds(values) is False:
            wanted |= requirement.wanted(values)
    return {name: value for name, value in wanted.items() if values.get(name) is not None}


def names_read(requirements: Iterable[Requirement]) -> tuple[str, ...]:
    """Return every parameter that the requirements read, once each."""
    return tuple(dict.fromkeys(n for requirement in requirements for n in requirement.names))
