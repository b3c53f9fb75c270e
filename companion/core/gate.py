"""The return budget: does flying on keep the promise of coming home?"""

from dataclasses import dataclass

from companion.core.energy_ledger import EnergyBelief
from companion.core.route_energy import Leg, RouteEnergy
from companion.core.wind_estimator import WindBelief
from companion.core.wind_outlook import WindOutlook


@dataclass(frozen=True, slots=True)
class WayHome:
    """One way to a landing site: its name ("depot" or a rally point's) and legs to the ground.

    `unattended_legs`: the same when no further command arrives (fixed ground speeds).
    """

    landing: str
    legs: tuple[Leg, ...]
    unattended_legs: tuple[Leg, ...] = ()


@dataclass(frozen=True, slots=True)
class Stage:
    """Legs to the next decision point, and the ways home from there.

    `delivers` marks the stage that ends with the parcel released.
    """

    legs: tuple[Leg, ...]
    ways_home: tuple[WayHome, ...]
    delivers: bool = False


@dataclass(frozen=True, slots=True)
class Ahead:
    """The whole remaining mission: ways home from here, and the stages that are left.

    After delivery, or on the way back, `stages` is empty and `delivered` tells which.
    """

    ways_home_now: tuple[WayHome, ...]
    stages: tuple[Stage, ...] = ()
    delivered: bool = False


@dataclass(frozen=True, slots=True)
class GateParams:
    """The operator's risk and ours. `reserve_wh` must still be there after landing."""

    max_loss: float
    reserve_wh: float
    min_success: float = 0.02
    samples: int = 512


@dataclass(frozen=True, slots=True)
class Assessment:
    """The gate's answer; probabilities as in evaluation.md, section 8.

    `turn_back`: fly the way home now, to `best_landing`. `p_home_unattended`: landing home if no
    further command ever arrives (None where no way home has unattended legs).
    `energy_need_wh` is the mean need of the whole remaining mission.
    """

    t_s: float
    p_home: float
    p_home_now: float
    p_success: float
    margin_wh: float
    turn_back: bool
    best_landing: str
    p_home_unattended: float | None
    energy_left_wh: float
    energy_need_wh: float
    reason: str


class Gate:
    """Answers `assess` for one airframe; keeps nothing between calls but its random numbers."""

    def __init__(self, route_energy: RouteEnergy, params: GateParams) -> None:
        raise NotImplementedError

    def assess(
        self, ahead: Ahead, wind: WindBelief, outlook: WindOutlook, energy: EnergyBelief
    ) -> Assessment:
        """Judge the remaining mission under wind, its change, and the models' own errors."""
        raise NotImplementedError
