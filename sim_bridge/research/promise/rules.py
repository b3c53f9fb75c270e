"""Return rules compared with the gate: PX4's time rule, fixed thresholds, the clairvoyant.

All depart immediately, except the clairvoyant. Rules are evaluated every second while outbound,
not after delivery, since the vehicle then returns in any case.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Bools, Floats
from sim_bridge.research.promise.truth import TrueMissions

PX4_FACTOR, PX4_ADDED_S = 1.1, 100.0
THRESHOLDS = {"threshold_25": 0.25, "threshold_35": 0.35}


@dataclass(frozen=True, slots=True)
class MissionOutcomes:
    """Mission outcomes. `margin_wh`: energy left at the end, negative if the pack ran out.
    `flight_h`: hours in the air, until the pack was empty if it ran out."""

    go: Bools
    delivered: Bools
    margin_wh: Floats
    flight_h: Floats

    @property
    def returned_home(self) -> Bools:
        """Departed and returned home."""
        return self.go & (self.margin_wh >= 0.0)

    @property
    def delivered_and_returned_home(self) -> Bools:
        """Delivered and returned home."""
        return self.returned_home & self.delivered

    @property
    def lost(self) -> Bools:
        """Departed and did not return home."""
        return self.go & ~self.returned_home

    @property
    def losses_and_flight_hours(self) -> tuple[int, float]:
        """Lost vehicles, and flight hours of the departed vehicles."""
        return int(self.lost.sum()), float(self.flight_h[self.go].sum())


def outcomes_of_turn_times(
    flown: TrueMissions, turn_s: Floats, departure_allowed: Bools | None = None
) -> MissionOutcomes:
    """Return the outcomes of missions that turn back `turn_s` after start (inf: they deliver)."""
    budget_wh = flown.power.budget_wh
    is_return = np.isfinite(turn_s)
    used_wh = np.where(
        is_return,
        flown.return_energy_wh(np.where(is_return, turn_s, 0.0)),
        flown.delivery_energy_wh(),
    )
    arrived_wh = flown.power.loaded_w * flown.arrival_s / 3600.0
    at_drop_wh = arrived_wh + flown.power.customer_energy_wh(np.zeros(1))[0]
    delivered = ~is_return & (at_drop_wh <= budget_wh)
    departs = np.ones(is_return.size, np.bool_) if departure_allowed is None else departure_allowed
    # Power depends little on the maneuver, so that the energy used gives the flight time.
    mean_w = np.where(
        is_return, flown.power.loaded_w, 0.5 * (flown.power.loaded_w + flown.power.empty_w)
    )
    air_h = np.fmin(used_wh, budget_wh) / mean_w  # NaN: the vehicle never arrives
    return MissionOutcomes(departs, delivered, budget_wh - used_wh, air_h)


def clairvoyant_outcomes(flown: TrueMissions) -> MissionOutcomes:
    """Return outcomes with perfect knowledge: depart only if the whole trip succeeds."""
    departs = flown.delivery_energy_wh() <= flown.power.budget_wh
    ends = outcomes_of_turn_times(flown, np.full(departs.size, math.inf), departs)
    return MissionOutcomes(departs, ends.delivered & departs, ends.margin_wh, ends.flight_h)


def outcomes_by_rule(flown: TrueMissions) -> dict[str, MissionOutcomes]:
    """Return the outcomes under each fixed rule and under the clairvoyant.

    PX4 turns back when `1.1 t + 100 s` exceeds the remaining flight time. `t`: distance home over
    cruise speed, without wind. PX4 uses the mean power of the last 60 s; here this is the loaded
    cruise power, constant while outbound at one airspeed. A threshold turns back when less than its
    share of the budget is left.
    """
    times_s = np.arange(flown.wind_ne_mps.shape[1], dtype=np.float64)
    count, budget_wh, loaded_w = flown.arrival_s.size, flown.power.budget_wh, flown.power.loaded_w
    left_wh = budget_wh - loaded_w * times_s / 3600.0
    out_m = np.stack([flown.outbound_distance_m(np.full(count, t)) for t in times_s], axis=1)
    px4_s = PX4_FACTOR * out_m / flown.profile.airspeed_mps + PX4_ADDED_S
    is_triggered_by_rule = {
        "px4_time": px4_s > left_wh * 3600.0 / loaded_w,
        **{
            name: np.broadcast_to(
                1.0 - loaded_w * times_s / 3600.0 / budget_wh < frac, (count, times_s.size)
            )
            for name, frac in THRESHOLDS.items()
        },
    }
    is_outbound = times_s <= flown.arrival_s[:, None]
    found: dict[str, MissionOutcomes] = {}
    for name, is_triggered in is_triggered_by_rule.items():
        hit = is_triggered & is_outbound
        first_s = np.where(hit.any(axis=1), times_s[hit.argmax(axis=1)], math.inf)
        found[name] = outcomes_of_turn_times(flown, first_s)
    return found | {"clairvoyant": clairvoyant_outcomes(flown)}
