"""What an alarm is worth at the gate: how often a flight that it allowed needs more than there is.

One decision a flight, by the budget's own rule (`Budget.p_enough`): may a mission of a drawn need
be flown? A loss is a flight that was allowed and used more than its pack gave. Nothing is turned
back or learned on the way, and the reserve is not counted on, so that losses come often enough to
be counted.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from companion.core.base.arrays import Floats

FULL_WH, PACK_STD_FRAC, MODEL_STD_FRAC = 105.0, 0.02, 0.04
"""An M100's pack above its reserve, as its airframe file states packs and model."""

LEAST_NEED, MOST_NEED = 0.7, 1.0
"""Needs that are asked for, of what a full pack gives: all near the limit, where a gate decides."""


@dataclass(frozen=True, slots=True)
class Losses:
    """Flights allowed, and lost, of all that were asked for."""

    asked: int
    allowed: int
    lost: int

    @property
    def share(self) -> float:
        """Of the flights allowed."""
        return self.lost / max(self.allowed, 1)


def judge(
    draw: Floats,
    capacity: Floats,
    believed: tuple[Floats, Floats, Floats],
    max_loss: float,
    rng: np.random.Generator,
) -> Losses:
    """Ask for one mission a flight. `draw` is the log ratio of the energy that it would use,
    `capacity` the log of the share that its pack has; `believed` are mean and std of the draw's
    log, and the share of the capacity. All of one shape.
    """
    mean, std, share = believed
    need_wh = FULL_WH * rng.uniform(LEAST_NEED, MOST_NEED, draw.shape)
    left_wh = FULL_WH * share
    p_enough = _p_enough(need_wh * np.exp(mean), left_wh, np.hypot(MODEL_STD_FRAC, std))
    allowed = p_enough >= 1.0 - max_loss
    has_wh = FULL_WH * np.exp(capacity + PACK_STD_FRAC * rng.standard_normal(draw.shape))
    lost = allowed & (need_wh * np.exp(draw) > has_wh)
    return Losses(draw.size, int(allowed.sum()), int(lost.sum()))


def _p_enough(need_wh: Floats, left_wh: Floats, model_std_frac: Floats) -> Floats:
    """`Budget.p_enough` where each flight has a budget of its own."""
    return ndtr((left_wh - need_wh) / np.hypot(PACK_STD_FRAC * left_wh, model_std_frac * need_wh))
