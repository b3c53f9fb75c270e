"""Which loss a number of days supports.

Split conformal prediction (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World,
2005) with days as the sample: flights of one day share air, packs and pilot and are not
exchangeable, days are. With n days that the model was not fitted to, the largest ratio of a new day
is over the largest of them all with at most 1 / (n + 1).
"""

import math

from companion.core.base.errors import LeewayError

CONFIDENCE = 0.95


def supported_loss(days: int) -> float:
    """Chance that a new day is over the bound, taken over the draw of these days too."""
    return 1.0 / (days + 1)


def confident_loss(days: int, confidence: float = CONFIDENCE) -> float:
    """The chance that is not exceeded with this confidence, days in hand: n of n days without loss
    (Clopper and Pearson, Biometrika 26, 1934)."""
    return 1.0 - (1.0 - confidence) ** (1.0 / days)


def days_needed(max_loss: float) -> int:
    """Days that support this loss; LeewayError unless it lies between 0 and 1."""
    _check(max_loss)
    return math.ceil(1.0 / max_loss - 1.0 - 1e-9)


def days_needed_confidently(max_loss: float, confidence: float = CONFIDENCE) -> int:
    """Days without a loss that support it with this confidence: 299 for 1 % at 95 %."""
    _check(max_loss)
    return math.ceil(math.log(1.0 - confidence) / math.log(1.0 - max_loss) - 1e-9)


def _check(max_loss: float) -> None:
    if not 0.0 < max_loss < 1.0:
        raise LeewayError(f"loss of {max_loss:g}: more than 0 and less than 1 expected")
