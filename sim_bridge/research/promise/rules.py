"""The rules compared with the gate: PX4's time rule, fixed thresholds, the clairvoyant.

All depart at once, except the clairvoyant. All are evaluated every second on the way out. None
is after the delivery, where nothing is left to turn back from.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bools, Floats
from sim_bridge.research.promise.truth import TrueMissions

PX4_FACTOR, PX4_ADDED_S = 1.1, 100.0
THRESHOLDS = {"threshold_25": 0.25, "threshold_35": 0.35}


@dataclass(frozen=True, slots=True)
class Ends:
    """How each mission ended; `margin_wh` is the energy left at the end, negative if it ran out.
    `air_h`: hours in the air, to where a pack that ran out was empty."""

    go: Bools
    delivered: Bools
    margin_wh: Floats
    air_h: Floats

    def of(self, numbers: NDArray[np.int64]) -> "Ends":
        """A subset of the missions."""
        return Ends(
            self.go[numbers], self.delivered[numbers], self.margin_wh[numbers], self.air_h[numbers]
        )

    @property
    def home(self) -> Bools:
        """Departed and came home."""
        return self.go & (self.margin_wh >= 0.0)

    @property
    def success(self) -> Bools:
        """Delivered and came home."""
        return self.home & self.delivered

    @property
    def lost(self) -> Bools:
        """Departed and did not come home."""
        return self.go & ~self.home


def ends_of(flown: TrueMissions, turn_s: Floats, go: Bools | None = None) -> Ends:
    """Ends of missions that turn back `turn_s` after their start (inf: they deliver)."""
    budget_wh = flown.power.budget_wh + flown.pack_wh
    turned = np.isfinite(turn_s)
    spent = np.where(turned, flown.turning_wh(np.where(turned, turn_s, 0.0)), flown.delivering_wh())
    arrived_wh = flown.power.loaded_w * flown.arrival_s / 3600.0
    at_drop_wh = arrived_wh + flown.power.deliver_wh(np.zeros(1))[0]
    delivered = ~turned & (at_drop_wh <= budget_wh)
    going = np.ones(turned.size, np.bool_) if go is None else go
    # Power hardly depends on what is flown, so that the energy spent tells the time.
    mean_w = np.where(
        turned, flown.power.loaded_w, 0.5 * (flown.power.loaded_w + flown.power.empty_w)
    )
    air_h = np.fmin(spent, budget_wh) / mean_w  # NaN: it never arrives
    return Ends(going, delivered, budget_wh - spent, air_h)


def clairvoyant(flown: TrueMissions) -> Ends:
    """Departs only where the whole trip will succeed."""
    going = flown.delivering_wh() <= flown.power.budget_wh + flown.pack_wh
    ends = ends_of(flown, np.full(going.size, math.inf), going)
    return Ends(going, ends.delivered & going, ends.margin_wh, ends.air_h)


def px4_time(flown: TrueMissions) -> Ends:
    """Returns when `1.1 t + 100 s` exceeds the remaining flight time.

    `t`: distance home over cruise speed, without wind. PX4 uses the mean power of the last 60 s.
    Here that is the loaded cruise power, constant on the way out at one airspeed.
    """
    times = _seconds(flown)
    out_m = np.stack([flown.out_m(np.full(flown.arrival_s.size, t)) for t in times], axis=1)
    home_s = out_m / flown.profile.airspeed_mps
    left_wh = flown.power.budget_wh - flown.power.loaded_w * times / 3600.0
    remaining_s = left_wh * 3600.0 / flown.power.loaded_w
    return ends_of(
        flown, _first(PX4_FACTOR * home_s + PX4_ADDED_S > remaining_s[None, :], times, flown)
    )


def threshold(flown: TrueMissions, frac: float) -> Ends:
    """Returns when less than `frac` of the budget is left."""
    times = _seconds(flown)
    left = 1.0 - flown.power.loaded_w * times / 3600.0 / flown.power.budget_wh
    closed = np.broadcast_to(left < frac, (flown.arrival_s.size, times.size))
    return ends_of(flown, _first(closed, times, flown))


def _seconds(flown: TrueMissions) -> Floats:
    return np.arange(flown.wind_ne_mps.shape[1], dtype=np.float64)


def _first(closed: Bools, times_s: Floats, flown: TrueMissions) -> Floats:
    """First second of each row's way out at which the rule triggered; infinite if never."""
    open_yet = times_s[None, :] <= flown.arrival_s[:, None]
    hit = closed & open_yet
    return np.where(hit.any(axis=1), times_s[hit.argmax(axis=1)], math.inf)
