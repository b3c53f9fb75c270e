"""Which air the vehicle is in: two hypotheses, weighed by what each foretold.

A filter that learns how gusty it is needs some 20 s for it, and what it takes in the meantime for
gusts it cannot learn trim and drag from: in calm air at 18 m/s it was 0.8 m/s off until the vehicle
turned, where one that is told that it is calm is 0.3 off. So two filters see the same: one that
begins in gusts as the parameters have them and learns, one that holds the air for calm. Each
foretells every measurement, and how well is its likelihood; by Bayes that is its chance (Magill
1965, a bank of filters), and what is believed is their mixture. Gusts tell on the calm one within
seconds. Chances leak back by little, since weather changes.

Calm is a hypothesis in light wind only. Where the wind blows, turbulence follows from it (Panofsky
and Dutton 1984, ch. 6): a calm filter there takes gusts for wrong drag, agrees with itself, and is
believed (on a real flight in 6 m/s, drag gains of 0.5 and 0.4, and 10 m/s of wind for a minute).
"""

import math
from collections.abc import Sequence

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.drag_update import TiltTold
from companion.core.wind.ekf import WindEstimatorParams, WindState
from companion.core.wind.turbulence import Turbulence

CALM_RATIO = 0.02
"""The gusts' variance in calm over the prior's: 0.06 m/s where the prior has 0.45."""
CHANGES_AFTER_S = 1000.0
"""[est] How long the air stays what it is."""
CALM_MOST_WIND_MPS = 3.0
"""Wind below which gusts no longer go with it, as in the filter's `least_wind_mps`."""
CHANCE_AFTER_WIND = 0.1
"""[est] Where it blew just now."""
NOISE_MEMORY_S = 10.0
LEAST_NOISE = 0.05


class Airs:
    """The usual air and calm, each with a filter of its own, and the chance of calm.

    `calm` is `None` while it blows: then there is one filter.
    """

    __slots__ = ("_noise", "calm", "chance_calm", "usual")

    def __init__(self, usual: WindState, calm: WindState | None, chance_calm: float = 0.5) -> None:
        self.usual = usual
        self.calm = None if calm is None else _held_calm(calm)
        self.chance_calm = 0.0 if calm is None else chance_calm
        self._noise = 1.0

    @classmethod
    def unseen(cls, airframe: Airframe, params: WindEstimatorParams) -> "Airs":
        """Before anything is seen."""
        calm = WindState(airframe, params) if params.weighs_calm else None
        return cls(WindState(airframe, params), calm)

    def copy(self) -> "Airs":
        """An independent copy: the same airs for filters that hear more."""
        calm = None if self.calm is None else self.calm.copy()
        other = Airs(self.usual.copy(), calm, self.chance_calm)
        other._noise = self._noise
        return other

    @property
    def states(self) -> tuple[WindState, ...]:
        """The filters there are: the usual one, and the calm one where it may be calm."""
        return (self.usual,) if self.calm is None else (self.usual, self.calm)

    @property
    def likelier(self) -> WindState:
        """The filter of the air that it more probably is."""
        return self.usual if self.calm is None or self.chance_calm <= 0.5 else self.calm

    def mind_wind(self) -> None:
        """End the calm hypothesis where the usual filter finds too much wind for it; begin it anew
        from that filter where the wind has gone down."""
        usual = self.usual
        if not usual.wind_is_known:
            return
        if usual.least_wind_speed_mps > CALM_MOST_WIND_MPS:
            self.calm, self.chance_calm = None, 0.0
        elif self.calm is None and usual.weighs_calm:
            self.calm, self.chance_calm = _held_calm(usual.copy()), CHANCE_AFTER_WIND

    def weigh(self, told: Sequence[TiltTold], sigmas: float, dt_s: float) -> None:
        """Take what one measurement said to the usual filter and to the calm one, in this order.

        Where readings are better, or worse, than their stated noise, that tells nothing of the air:
        innovations are held against what the usual filter's have come to lately.
        """
        share = -math.expm1(-dt_s / NOISE_MEMORY_S)
        self._noise += share * (min(told[0].surprise, sigmas**2) - self._noise)
        if self.calm is None:
            return
        noise = max(self._noise, LEAST_NOISE)
        usual, calm = (one.log_density(sigmas, noise) for one in told[:2])
        odds = self.chance_calm / (1.0 - self.chance_calm) * math.exp(_held(calm - usual))
        leak = -math.expm1(-dt_s / CHANGES_AFTER_S)
        self.chance_calm = (1.0 - leak) * odds / (1.0 + odds) + 0.5 * leak

    def ten_second_mean(self, waited_s: float) -> tuple[Floats, Floats]:
        """Mean and covariance of the mixture, see `WindState.ten_second_mean`."""
        usual, usual_cov = self.usual.ten_second_mean(waited_s)
        if self.calm is None:
            return usual, usual_cov
        calm, calm_cov = self.calm.ten_second_mean(waited_s)
        p = self.chance_calm
        apart = calm - usual
        cov = (1.0 - p) * usual_cov + p * calm_cov + p * (1.0 - p) * np.outer(apart, apart)
        return usual + p * apart, cov


def _held_calm(state: WindState) -> WindState:
    state.turbulence = Turbulence(CALM_RATIO, is_held=True)
    return state


def _held(log_ratio: float) -> float:
    """One measurement may say so much and no more: what it says is Gaussian only near the mean."""
    return min(max(log_ratio, -10.0), 10.0)
