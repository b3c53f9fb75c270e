"""The three promises that are watched, the bet against each, and how often a false alarm may come.

All false alarms together have a chance of 1 %, for a service of any length: 0.5 % go to the draw,
0.1 % to the wind, 0.4 % to all packs, of which the k-th that is met gets 1 / (k (k + 1)); these sum
to 1, so that any number of packs may come.
"""

import math

from companion.core.monitor.e_process import ShareTest, ShiftTest

DRAW, PACK, WIND = "draw", "pack", "wind"

FALSE_ALARM = {DRAW: 0.005, PACK: 0.004, WIND: 0.001}

DRAW_STD = 0.028
"""Log ratio of one flight's energy around the model's, within a day: 2.4 % on 119 flights of an
M100 (Rodrigues et al., Scientific Data 8, 2021), and a sixth more, as other sites' may differ more.
"""

DRAW_TEST = ShiftTest(tolerance=0.02, day_std=0.018, shifts=(0.03, 0.06, 0.12), most=0.15)
"""A power model is fitted to about 2 % rms, and so far it may be off for good. Days of that M100
differ by 1.5 %, known from 11 days to a fifth of it. A single flight counts as 15 % more at the
most, which alone is no alarm."""

PACK_TEST = ShiftTest(tolerance=0.06, day_std=0.02, shifts=(0.06, 0.12, 0.2), most=0.4)
"""Packs differ by 2 % when new (`usable_std_frac`), and resting voltages by charge from one make to
the next by some per cent. A pack at 0.8 has a log ratio of 0.22."""

WIND_TEST = ShareTest(allowed=0.10, stakes=(1.0, 3.0, 6.0))
"""One check in 20 fails where all is right. Twice that is allowed: a wind process was fitted to
other days."""


def threshold(promise: str, order: int = 1) -> float:
    """Log of the e-value at which an alarm comes; `order` of a pack, from 1."""
    share = 1.0 / (order * (order + 1)) if promise == PACK else 1.0
    return -math.log(FALSE_ALARM[promise] * share)


def bets_of(promise: str) -> int:
    """How many bets are mixed."""
    tests = {DRAW: DRAW_TEST.shifts, PACK: PACK_TEST.shifts, WIND: WIND_TEST.stakes}
    return len(tests[promise])
