"""Energy and success probabilities of one delivery, computed before the flight."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.certificate.evidence import RiskEvidence
from companion.core.ground.ground_strip import Peak
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import (
    DROP_TOTAL_S,
    SETTLE_MARGIN_S,
    FlightPlan,
    build_site_map,
    depot_frame,
    make_plan,
)
from companion.core.return_budget.budget import Assessment, Gate, GateParams
from companion.core.return_budget.remaining_from_plan import remaining_outbound
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.air import standard_air
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from companion.core.wind.process import WindProcessParams

OBSERVER_HEIGHT_M = 2.0
"""Height of the eyes of an observer, or of an antenna, at the depot."""


@dataclass(frozen=True, slots=True)
class CruiseWind:
    """Wind at cruise height; `from_deg` clockwise from north, `std_mps` one sigma."""

    speed_mps: float
    from_deg: float
    std_mps: float


@dataclass(frozen=True, slots=True)
class FlightEstimate:
    """A flight, its plan, its energy, and its assessment by the return budget."""

    flight: Flight
    planned: FlightPlan
    energy: EnergyBelief
    reserve_wh: float
    assessment: Assessment
    evidence: RiskEvidence

    @property
    def min_ground_clearance_m(self) -> float | None:
        """Minimum height of the planned legs over the known ground of their corridors."""
        site, plan = self.planned.site, self.planned.plan
        if site.ground is None:
            return None
        routes = plan.outbound_ned_m, (plan.return_route_start_ned_m, *plan.return_ned_m)
        lines = [line for route in routes for line in pairwise(route)]
        return min(
            min(-a[2], -b[2]) - peak.up_m
            for a, b in lines
            if isinstance(peak := site.ground.highest_ground_in_corridor(a, b), Peak)
        )

    @property
    def is_drop_visible(self) -> bool | None:
        """Whether the vehicle at its drop height is visible from the depot; None: unknown."""
        site, customer = self.planned.site, self.planned.plan.customer_ned_m
        if site.ground is None:
            return None
        north, east, down = customer
        drop = (north, east, down - self.flight.mission.drop_height_m)
        return site.ground.strip.has_line_of_sight((0.0, 0.0, -OBSERVER_HEIGHT_M), drop)


def estimate_flight(
    flight: Flight,
    airframe: Airframe,
    wind_process: WindProcessParams,
    obstacles: dict[str, Any] | None,
    wind: CruiseWind,
    charge_frac: float | None = None,
) -> FlightEstimate:
    """Plan a flight and assess it at its start.

    `obstacles`: the GeoJSON that the flight names. `charge_frac` None: as in the file. Raises
    LeewayError if the flight has no depot or there is no route.
    """
    depot = flight.site.depot
    if depot is None:
        raise LeewayError("site.depot: needed for an estimate (lat_deg, lon_deg, ...)")
    air = standard_air(depot.alt_amsl_m or 0.0, flight.site.air_temperature_c)
    route_energy = RouteEnergy.for_mission(airframe, flight.mission, air.density_kgpm3)
    energy = _rested_battery_energy(flight, airframe, route_energy, charge_frac)
    site = build_site_map(flight, depot_frame(depot), obstacles)
    planner = BerPlanner(route_energy)
    planned = make_plan(flight, site, planner, energy, flight.mission.reserve_frac)
    if isinstance(planned, NoRoute):
        raise LeewayError(f"no route: {planned.reason}")
    angle = math.radians(wind.from_deg)
    to_ne = np.array([-wind.speed_mps * math.cos(angle), -wind.speed_mps * math.sin(angle)])
    wind_estimate = WindBelief(0.0, to_ne, wind.std_mps**2 * np.eye(2), ("forecast",), True)
    outlook = WindOutlook(wind_process)
    outlook.update_from_estimate(wind_estimate)
    reserve_wh = flight.mission.reserve_frac * energy.usable_full_wh
    evidence = RiskEvidence(wind_process)
    gate = Gate(route_energy, GateParams(flight.mission.max_loss, reserve_wh))
    remaining_flight = remaining_outbound(
        planned.plan,
        planned.plan.depot_ned_m,
        0,
        flight.vehicle.payload_kg,
        flight.mission.drop_height_m,
        DROP_TOTAL_S,
        flight.mission.wind_settle_s + SETTLE_MARGIN_S,
    )
    models = remaining_flight, wind_estimate, outlook, energy
    assessment = gate.with_evidence_limit(gate.assess(*models), evidence.doubt, *models)
    return FlightEstimate(flight, planned, energy, reserve_wh, assessment, evidence)


def _rested_battery_energy(
    flight: Flight, airframe: Airframe, route_energy: RouteEnergy, charge_frac: float | None
) -> EnergyBelief:
    """Return the energy estimate of a rested pack of the stated charge, as in the energy ledger."""
    vehicle, battery = flight.vehicle, airframe.battery
    draw_w = route_energy.hover_power_w(vehicle.payload_kg)
    full_wh = battery.usable_energy_of_full_pack_wh(
        draw_w, vehicle.temperature_c, vehicle.battery_health_frac
    )
    charge = charge_frac if charge_frac is not None else vehicle.stated_charge_frac
    left_wh = full_wh * (charge if charge is not None else 1.0)
    return EnergyBelief(
        0.0, left_wh, battery.usable_std_frac * left_wh, full_wh, "charge as stated"
    )
