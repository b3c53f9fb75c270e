"""The three monitored promises, the test of each, and the false alarm probabilities.

The probability of any false alarm is 1 %, for a service of any length: 0.5 % for the draw, 0.1 %
for the wind, 0.4 % for all packs, of which the k-th pack gets 1 / (k (k + 1)). These shares sum to
1 for any number of packs.
"""

import math

from companion.core.monitor.e_process import ShareTest, ShiftTest

DRAW, PACK, WIND = "draw", "pack", "wind"

FALSE_ALARM = {DRAW: 0.005, PACK: 0.004, WIND: 0.001}

DRAW_STD = 0.028
"""Std of the log ratio of one flight's energy to the model's, within a day: 2.4 % on 119 flights of
an M100 (Rodrigues et al., Scientific Data 8, 2021), plus a sixth for other sites.
"""

DRAW_TEST = ShiftTest(tolerance=0.02, day_std=0.018, shifts=(0.03, 0.06, 0.12), max_value=0.15)
"""The tolerance is the error of a fitted power model, about 2 % rms. Days of that M100 differ by
1.5 %, known from 11 days to a fifth of it. A single flight counts as at most 15 % more, which is
not enough for an alarm."""

PACK_TEST = ShiftTest(tolerance=0.06, day_std=0.02, shifts=(0.06, 0.12, 0.2), max_value=0.4)
"""New packs differ by 2 % (`usable_std_frac`), and the resting voltage curves of manufacturers by a
few per cent. A pack at 0.8 has a log ratio of 0.22."""

WIND_TEST = ShareTest(allowed=0.10, stakes=(1.0, 3.0, 6.0))
"""One check in 20 fails with a correct model. Twice that is allowed, because the wind process was
fitted to other days."""


def alarm_log_e_threshold(promise: str, pack_number: int = 1) -> float:
    """Return the log of the e-value of an alarm; `pack_number` is a pack's number, from 1."""
    share = 1.0 / (pack_number * (pack_number + 1)) if promise == PACK else 1.0
    return -math.log(FALSE_ALARM[promise] * share)


def bet_count_of_promise(promise: str) -> int:
    """Return the number of bets in the mixture."""
    tests = {DRAW: DRAW_TEST.shifts, PACK: PACK_TEST.shifts, WIND: WIND_TEST.stakes}
    return len(tests[promise])
