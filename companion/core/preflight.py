"""The pre-flight in words: what is missing, what is off, which failsafe the promise rests on.

The lists of parameters are the flavours' own (adapters); how they are judged is here.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

Values = Mapping[str, float | None]


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

    @property
    def rtl_height_m(self) -> float:
        """The least height at which a straight line home is clear of everything on the site."""
        return self.highest_obstacle_m + 10.0 if self.highest_obstacle_m > 0.0 else 0.0


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


def judge(requirements: Iterable[Requirement], values: Values) -> tuple[Finding, ...]:
    """Return what is off, required things first."""
    found: list[Finding] = []
    for requirement in requirements:
        holds = requirement.holds(values)
        if holds:
            continue
        name = requirement.names[0]
        if holds is None:
            words = f"{requirement.words}: this autopilot does not tell ({name})"
            found.append(Finding(name, words, blocks=requirement.required))
        else:
            shown = ", ".join(
                f"{n} = {v:g}" for n in requirement.names if (v := values.get(n)) is not None
            )
            words = f"{requirement.words} ({shown})"
            found.append(Finding(name, words, blocks=requirement.required))
    return tuple(sorted(found, key=lambda f: not f.blocks))


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
