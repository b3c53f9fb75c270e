"""Loss that a number of days supports.

Split conformal prediction (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World,
2005) with days as the sample: flights of one day share air, packs and pilot and are not
exchangeable, days are. With n days that the model was not fitted to, the largest ratio of a new day
exceeds the largest of them all with probability at most 1 / (n + 1).
"""

import math

from companion.core.base.errors import LeewayError

COVERAGE = 0.95


def supported_loss_probability(day_count: int) -> float:
    """Return the probability that a new day exceeds the bound, over random draws of all days."""
    return 1.0 / (day_count + 1)


def loss_upper_confidence_limit(loss_free_day_count: int, confidence: float = COVERAGE) -> float:
    """Return the upper confidence limit of the loss for the given days: n of n days without loss
    (Clopper and Pearson, Biometrika 26, 1934)."""
    return 1.0 - (1.0 - confidence) ** (1.0 / loss_free_day_count)


def days_needed_for_loss(max_loss: float) -> int:
    """Return the days that support this loss; LeewayError unless it lies between 0 and 1."""
    _check_loss_probability(max_loss)
    return math.ceil(1.0 / max_loss - 1.0 - 1e-9)


def loss_free_days_needed(max_loss: float, confidence: float = COVERAGE) -> int:
    """Return the days without a loss that support it with confidence: 299 for 1 % at 95 %."""
    _check_loss_probability(max_loss)
    return math.ceil(math.log(1.0 - confidence) / math.log(1.0 - max_loss) - 1e-9)


def _check_loss_probability(max_loss: float) -> None:
    if not 0.0 < max_loss < 1.0:
        raise LeewayError(f"loss of {max_loss:g}: expected more than 0 and less than 1")
