"""Energy of an airborne flight in the wind behind an approaching front.

The desk evaluates straight lines in one wind, as advice to the operator. The vehicle decides by its
own return budget, in the wind that it measures.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.geo import Ned
from companion.core.mission.flight_plan import DROP_TOTAL_S
from companion.core.routing.leg_energy import Leg, LegKind
from ground_station.core.feasibility.reach import SortieFeasibility, round_up_payload_kg
from ground_station.core.schema.day import Forecast


@dataclass(frozen=True, slots=True)
class AirborneFlight:
    """An airborne flight: position, landing site (NED about the depot, `home` on the ground),
    customer's ground point while the parcel is carried, and usable energy left.
    """

    position: Ned
    home: Ned
    customer: Ned | None
    payload_kg: float
    remaining_wh: float


@dataclass(frozen=True, slots=True)
class FlightMargins:
    """Energy margin above the reserve at the accepted loss, for the planned flight
    (`mission_margin_wh`) and for an immediate return (`return_margin_wh`). Minus infinity: the wind
    exceeds the vehicle's speed.
    """

    mission_margin_wh: float
    return_margin_wh: float

    @property
    def operator_recommendation(self) -> str:
        """Recommended operator action; empty if the flight can continue."""
        if self.mission_margin_wh >= 0.0:
            return ""
        if self.return_margin_wh >= 0.0:
            return (
                f"mission {_shortfall_text(self.mission_margin_wh)} in the wind behind the"
                " front: recall it"
            )
        return (
            f"return {_shortfall_text(self.return_margin_wh)} in the wind behind the front:"
            " check it"
        )


def energy_margins_in_wind(
    feasibility: SortieFeasibility, flight: AirborneFlight, wind: Forecast
) -> FlightMargins:
    """Evaluate the rest of the flight in this wind."""
    in_wind = feasibility.copy_for_wind(wind)
    home = _energy_margin_above_reserve_wh(in_wind, flight, _return_legs(flight, flight.payload_kg))
    if flight.customer is None:
        return FlightMargins(home, home)
    return FlightMargins(
        _energy_margin_above_reserve_wh(
            in_wind, flight, _remaining_mission_legs(in_wind, flight, flight.customer)
        ),
        home,
    )


def _return_legs(flight: AirborneFlight, payload_kg: float) -> list[Leg]:
    over = (flight.home[0], flight.home[1], flight.position[2])
    mass = round_up_payload_kg(payload_kg)
    return [
        Leg(LegKind.CRUISE, flight.position, over, mass),
        Leg(LegKind.LAND, over, flight.home, mass),
    ]


def _remaining_mission_legs(
    feasibility: SortieFeasibility, flight: AirborneFlight, customer: Ned
) -> list[Leg]:
    mass, up = round_up_payload_kg(flight.payload_kg), flight.position[2]
    over = (customer[0], customer[1], up)
    low = (customer[0], customer[1], customer[2] - feasibility.mission.drop_height_m)
    end = (flight.home[0], flight.home[1], up)
    return [
        Leg(LegKind.CRUISE, flight.position, over, mass),
        Leg(LegKind.DESCEND, over, low, mass),
        Leg(LegKind.HOVER, low, low, mass, duration_s=DROP_TOTAL_S),
        Leg(LegKind.CLIMB, low, over, 0.0),
        Leg(LegKind.CRUISE, over, end, 0.0),
        Leg(LegKind.LAND, end, flight.home, 0.0),
    ]


def _energy_margin_above_reserve_wh(
    feasibility: SortieFeasibility, flight: AirborneFlight, leg_list: list[Leg]
) -> float:
    costs = feasibility.energy.leg_costs_wind_major(
        tuple(leg_list), feasibility.wind_to_ne_mps[None, :]
    )
    if not costs.feasible.all():
        return -math.inf
    mean_wh = float(np.sum(costs.energy_wh))
    wind_wh = feasibility.energy.route_energy_std_wh(
        tuple(leg_list), feasibility.wind_to_ne_mps, feasibility.wind_cov_ne_m2ps2
    )
    model_wh = feasibility.airframe.power_rotor.model_std_frac * mean_wh
    full_wh = feasibility.full_pack_usable_wh(flight.payload_kg)
    battery_wh = feasibility.airframe.battery.usable_std_frac * flight.remaining_wh
    spare_wh = flight.remaining_wh - feasibility.mission.reserve_frac * full_wh - mean_wh
    return spare_wh - feasibility.sigmas * math.hypot(wind_wh, model_wh, battery_wh)


def _shortfall_text(spare_wh: float) -> str:
    return f"{-spare_wh:.0f} Wh short" if math.isfinite(spare_wh) else "not possible"
