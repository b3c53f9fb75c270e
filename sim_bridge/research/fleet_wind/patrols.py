"""Where the drones are: some fly orders out and back, some hover or wait where they are."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats

SITE_M = 750.0
"""Half the side of the site: 1.5 km."""
HEIGHT_M = 40.0
GROUND_SPEED_MPS = 12.0
AT_CUSTOMER_S = 40.0
AT_DEPOT_S = 20.0


@dataclass(frozen=True, slots=True)
class Patrol:
    """One drone's way as corners: times (n,) and places (n, 2); before and after it stays."""

    name: str
    t_s: Floats
    place_ne_m: Floats

    def at(self, t_s: Floats) -> Floats:
        """Places (m, 2) at times (m,)."""
        axes = [np.interp(t_s, self.t_s, self.place_ne_m[:, axis]) for axis in (0, 1)]
        return np.stack(axes, axis=-1)


def patrols(drones: int, hovering: int, seconds: float, rng: np.random.Generator) -> list[Patrol]:
    """The last `hovering` of so many drones stay at places of their own; the others fly orders."""
    found: list[Patrol] = []
    for number in range(drones):
        name = f"drone-{number + 1}"
        if number >= drones - hovering:
            place = rng.uniform(-SITE_M, SITE_M, 2)
            found.append(Patrol(name, np.zeros(1), place[None, :]))
        else:
            found.append(_orders(name, seconds, rng))
    return found


def _orders(name: str, seconds: float, rng: np.random.Generator) -> Patrol:
    """Straight out to a customer anywhere on the site and straight back, again and again."""
    depot = rng.uniform(-100.0, 100.0, 2)
    times, places = [0.0], [depot]
    wait_s = float(rng.uniform(0.0, 60.0))
    while times[-1] < seconds:
        customer = rng.uniform(-SITE_M, SITE_M, 2)
        flown_s = max(math.dist(depot, customer) / GROUND_SPEED_MPS, 1.0)
        for pause_s, place in ((wait_s, depot), (flown_s, customer), (AT_CUSTOMER_S, customer),
                               (flown_s, depot)):  # fmt: skip
            times.append(times[-1] + max(pause_s, 1e-3))
            places.append(place)
        wait_s = AT_DEPOT_S
    return Patrol(name, np.array(times), np.array(places))
