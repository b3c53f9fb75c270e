"""What the monitor costs a companion: in flight, and at the end of one."""

from dataclasses import dataclass

import numpy as np

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.core.monitor.figures import FlightFigures, LogRatio
from companion.core.monitor.promises import DRAW_STD
from companion.core.monitor.service import after_flight, begun_anew
from companion.core.monitor.tally import FlightTally
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from sim_bridge.adapters.wall_clock import cpu_s

FLOWN_S, FLIGHTS = 1200, 50
REPEATS = 5
"""Others on the machine make a time longer, never shorter."""

LOOKS_AT_WIND, LOOKS_AT_PACK = 10, 5
"""Each second: at every tick, and as often as the estimates take the battery."""


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU time on this machine."""

    us_per_flight_s: float
    ms_per_flight: float


def flight_cost() -> Cost:
    """Time a flight of twenty minutes, and fifty ends of flights: the least of some repeats."""
    flown_s, ended_s = (min(part() for _ in range(REPEATS)) for part in (_in_flight_s, _at_ends_s))
    return Cost(1e6 * flown_s / FLOWN_S, 1e3 * ended_s / FLIGHTS)


def _in_flight_s() -> float:
    tally = FlightTally(read_airframe("m100").battery, 1.0)
    outlook = WindOutlook(read_wind_process("coast"))
    steps = [
        WindBelief(k / LOOKS_AT_WIND, np.array([5.0, 1.0]), 0.04 * np.eye(2), ("tilt",), True)
        for k in range(FLOWN_S * LOOKS_AT_WIND)
    ]
    began_s = cpu_s()
    for k, seen in enumerate(steps):
        tally.wind(seen, outlook)
        if k % (LOOKS_AT_WIND // LOOKS_AT_PACK) == 0:
            tally.compare(0.2, 440.0, 400.0, 0.1)
            tally.battery(seen.t_s, 23.0, 20.0, at_rest=False, on_ground=False)
    return cpu_s() - began_s


def _at_ends_s() -> float:
    service = begun_anew("m100", lost=False)
    told = FlightFigures(LogRatio(0.01, DRAW_STD), LogRatio(0.01, 0.055), 0, 5)
    began_s = cpu_s()
    for flight in range(FLIGHTS):
        service = after_flight(service, told, "A", str(flight), 3600.0 * flight)
    return cpu_s() - began_s
