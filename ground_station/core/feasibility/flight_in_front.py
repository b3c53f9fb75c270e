"""A flight in the air, priced anew in the wind behind a front that comes to it.

This is the desk's judgement, for people: straight lines in one wind. What the vehicle does is
decided by its own return budget, in the wind that it feels itself.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.geo import Ned
from companion.core.mission.flight_plan import DROP_S
from companion.core.routing.leg_energy import Leg, LegKind
from ground_station.core.feasibility.reach import Reach, rounded_up
from ground_station.core.schema.day import Forecast


@dataclass(frozen=True, slots=True)
class FlightNow:
    """A flight: where it is and where it lands (NED about the depot, the second on the ground), its
    customer's ground point while it has the parcel, and usable energy left.
    """

    here: Ned
    home: Ned
    customer: Ned | None
    payload_kg: float
    left_wh: float


@dataclass(frozen=True, slots=True)
class Judged:
    """Energy to spare above the reserve at the accepted loss, if it flies on as planned and if it
    turns home now. Minus infinity: that wind is too strong to make way in.
    """

    on_wh: float
    home_wh: float

    @property
    def words(self) -> str:
        """What a person should do about it; empty: it flies on."""
        if self.on_wh >= 0.0:
            return ""
        if self.home_wh >= 0.0:
            return f"flying on is {_short(self.on_wh)} in the wind behind it: recall it"
        return f"turning home is {_short(self.home_wh)} in the wind behind it: look at it"


def judged(reach: Reach, flight: FlightNow, wind: Forecast) -> Judged:
    """The flight in this wind from now on."""
    windy = reach.in_wind(wind)
    home = _spare_wh(windy, flight, _home(flight, flight.payload_kg))
    if flight.customer is None:
        return Judged(home, home)
    return Judged(_spare_wh(windy, flight, _on(windy, flight, flight.customer)), home)


def _home(flight: FlightNow, payload_kg: float) -> list[Leg]:
    over = (flight.home[0], flight.home[1], flight.here[2])
    mass = rounded_up(payload_kg)
    return [
        Leg(LegKind.CRUISE, flight.here, over, mass),
        Leg(LegKind.LAND, over, flight.home, mass),
    ]


def _on(reach: Reach, flight: FlightNow, customer: Ned) -> list[Leg]:
    mass, up = rounded_up(flight.payload_kg), flight.here[2]
    over = (customer[0], customer[1], up)
    low = (customer[0], customer[1], customer[2] - reach.mission.drop_height_m)
    end = (flight.home[0], flight.home[1], up)
    return [
        Leg(LegKind.CRUISE, flight.here, over, mass),
        Leg(LegKind.DESCEND, over, low, mass),
        Leg(LegKind.HOVER, low, low, mass, duration_s=DROP_S),
        Leg(LegKind.CLIMB, low, over, 0.0),
        Leg(LegKind.CRUISE, over, end, 0.0),
        Leg(LegKind.LAND, end, flight.home, 0.0),
    ]


def _spare_wh(reach: Reach, flight: FlightNow, legs: list[Leg]) -> float:
    costs = reach.energy.costs(tuple(legs), reach.wind_to_ne_mps[None, :])
    if not costs.feasible.all():
        return -math.inf
    mean_wh = float(np.sum(costs.energy_wh))
    wind_wh = reach.energy.route_std_wh(tuple(legs), reach.wind_to_ne_mps, reach.wind_cov_ne_m2ps2)
    model_wh = reach.airframe.power_rotor.model_std_frac * mean_wh
    full_wh = reach.full_wh(flight.payload_kg)
    battery_wh = reach.airframe.battery.usable_std_frac * flight.left_wh
    spare_wh = flight.left_wh - reach.mission.reserve_frac * full_wh - mean_wh
    return spare_wh - reach.sigmas * math.hypot(wind_wh, model_wh, battery_wh)


def _short(spare_wh: float) -> str:
    return f"{-spare_wh:.0f} Wh short" if math.isfinite(spare_wh) else "not possible"
