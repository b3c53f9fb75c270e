"""What a vehicle's state tells of its flight: the promise, and the way that is aboard."""

import math
import re
from collections.abc import Sequence
from typing import Any

import msgspec

from companion.core.base.arrays import Floats
from companion.core.mission.flight_plan import FlightPlan
from companion.core.pilot.pilot import Pilot
from companion.fleet.messages import LONGEST_WAY, MOST_COV_M2PS2
from companion.fleet.polyline import encoded


def told_of(pilot: Pilot) -> dict[str, Any]:
    """Fields of the state: what the pilot believes, where it is fresh, and its route."""
    seen, wind, energy = pilot.fresh_assessment, pilot.estimates.wind, pilot.estimates.energy
    told: dict[str, Any] = {"delivered": pilot.delivered, "home": _id(pilot.home)}
    if energy is not None:
        told["energy_left_wh"] = energy.mean_wh
    if wind is not None and wind.valid:
        north, east = (round(float(x), 3) for x in wind.mean_to_ne_mps)
        told["wind_to_n_mps"], told["wind_to_e_mps"] = north, east
        told["wind_cov_m2ps2"] = wind_cov(wind.cov_ne_m2ps2)
    if seen is not None:
        told["margin_wh"] = seen.margin_wh
        for name in ("p_home", "p_home_now", "p_success"):
            told[name] = share(getattr(seen, name))
    if pilot.flight_plan is not None:
        told["way_out"], told["way_home"] = ways(pilot.flight_plan)
    return told


def wind_cov(cov_ne_m2ps2: Floats) -> tuple[float, float, float] | msgspec.UnsetType:
    """North, north with east, east, in a few digits and never less in any direction; unset where
    it is none, or more than messages allow.
    """
    nn, ne, ee = (float(cov_ne_m2ps2[at]) for at in ((0, 0), (0, 1), (1, 1)))
    if not (math.isfinite(nn + ne + ee) and min(nn, ee) > 0.0 and ne * ne <= nn * ee):
        return msgspec.UNSET
    # Each rounding moves a number by less than 0.001: twice that on the diagonal outweighs them.
    told = round(nn + 0.002, 3), round(ne, 3), round(ee + 0.002, 3)
    return told if max(told) <= MOST_COV_M2PS2 else msgspec.UNSET


def ways(flown: FlightPlan) -> tuple[str, str]:
    """Out to the customer and home from there, as polylines; both empty where one is too long."""
    mission = flown.mission
    out = _way(flown, (mission.takeoff, *mission.outbound, mission.deliver))
    home = _way(flown, (mission.deliver, *mission.returning, mission.land))
    return (out, home) if max(len(out), len(home)) <= LONGEST_WAY else ("", "")


def _way(flown: FlightPlan, items: Sequence[int]) -> str:
    spots = (flown.mission.items[index].spot for index in items)
    return encoded((spot.lat_deg, spot.lon_deg) for spot in spots if spot is not None)


def _id(name: str | None) -> str | None:
    """A place's name as messages allow it: a rally point's may hold anything."""
    return None if name is None else re.sub(r"[^A-Za-z0-9._:-]", "-", name)[:64]


def share(p: float | None) -> float | None:
    """A probability as messages allow it: within 0 and 1."""
    return None if p is None else min(max(p, 0.0), 1.0)
