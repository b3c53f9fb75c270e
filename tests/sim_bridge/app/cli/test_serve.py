"""`sim-bridge serve`: places of the vehicles."""

import math
from itertools import combinations

from ground_station.core.dispatch.dispatch_rules import ON_PAD_M
from sim_bridge.app.cli.serve import SPACING_M, home_offset_ne_m


def test_seven_vehicles_get_orders_of_a_desk_at_the_first_ones_home():
    homes = [home_offset_ne_m(index) for index in range(20)]
    assert homes[0] == (0.0, 0.0)
    assert all(math.hypot(*home) < ON_PAD_M for home in homes[:7])
    assert min(math.dist(*pair) for pair in combinations(homes, 2)) > SPACING_M - 1e-6
