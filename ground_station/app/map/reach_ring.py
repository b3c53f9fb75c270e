"""Distance within which a drone can land on its reported remaining energy."""

import math
from dataclasses import dataclass, field

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import offset_position_deg
from companion.core.routing.leg_energy import Leg, LegKind
from companion.fleet.messages import State
from ground_station.app.map.drone_view import DroneFigures
from ground_station.app.map.picture import Point
from ground_station.core.feasibility.reach import (
    DayFeasibility,
    SortieFeasibility,
    find_max_feasible_distance_m,
    round_up_payload_kg,
)
from ground_station.core.schema.day_data import DayData

BEARING_COUNT = 48
SAMPLE_LEG_M = 1000.0
"""Length of the leg whose energy is computed: energy is proportional to length, except the stop."""

MAX_RADIUS_M = 200_000.0


@dataclass(slots=True)
class ReachableAreas:
    """Reach rings of one day's drones."""

    data: DayData
    _models: DayFeasibility = field(init=False)
    _figures: dict[str, DroneFigures] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._models = DayFeasibility(self.data.day, self.data.airframes)

    def drone_figures(self, name: str) -> DroneFigures | None:
        """Return the figures of a drone of the day."""
        drone = self.data.day.find_drone(name)
        if drone is None:
            return None
        if name not in self._figures:
            model = self._models.of_drone(drone)
            full_wh, mission = model.full_pack_usable_wh(0.0), model.mission
            self._figures[name] = DroneFigures(
                full_wh=full_wh,
                reserve_wh=mission.reserve_frac * full_wh,
                hover_power_w=model.energy.hover_power_w(0.0),
                cruise_airspeed_mps=model.energy.cruise_airspeed_mps,
                cruise_height_m=mission.cruise_height_m,
                descent_mps=model.airframe.speeds.landing_mps,
            )
        return self._figures[name]

    def reachable_boundary_points(self, state: State, payload_kg: float) -> list[Point] | None:
        """Return points in all directions where it can land on its reserve at the accepted loss.

        Assumes a straight line at its height in the wind that it reports (else the forecast), with
        the forecast's error; ignores obstacles. None: its state lacks required fields.
        """
        drone, remaining_wh = self.data.day.find_drone(state.vehicle), state.energy_left_wh
        if drone is None or remaining_wh is None or state.lat_deg is None or state.lon_deg is None:
            return None
        bearings = np.linspace(0.0, 2.0 * math.pi, BEARING_COUNT, endpoint=False)
        directions_ne = np.column_stack([np.cos(bearings), np.sin(bearings)])
        distance_m = _reachable_radii_m(
            self._models.of_drone(drone),
            state,
            round_up_payload_kg(payload_kg),
            remaining_wh,
            directions_ne,
        )
        lat, lon = offset_position_deg(
            state.lat_deg, state.lon_deg, *(distance_m * directions_ne.T)
        )
        return list(zip(map(float, lat), map(float, lon), strict=True))


def _reachable_radii_m(
    model: SortieFeasibility,
    state: State,
    payload_kg: float,
    remaining_wh: float,
    directions_ne: Floats,
) -> Floats:
    """Return the radius in each direction, (n, 2) unit vectors, metres."""
    up = -(state.height_rel_m or 0.0)
    wind = model.wind_to_ne_mps
    if state.wind_to_n_mps is not None and state.wind_to_e_mps is not None:
        wind = np.array([state.wind_to_n_mps, state.wind_to_e_mps])
    cruises = tuple(
        Leg(
            LegKind.CRUISE,
            (0.0, 0.0, up),
            (north * SAMPLE_LEG_M, east * SAMPLE_LEG_M, up),
            payload_kg,
        )
        for north, east in directions_ne
    )
    ends = cruises[0].to_ned_m
    land = Leg(LegKind.LAND, ends, (*ends[:2], 0.0), payload_kg)
    compiled = model.energy.group_legs_by_cost_formula(cruises, (None,) * len(cruises))
    costs = model.energy.leg_costs_wind_major(compiled, wind[None, :])
    per_m = costs.energy_wh[0] / SAMPLE_LEG_M
    gradients = model.energy.leg_energy_gradients_wh_per_mps(compiled, wind) / SAMPLE_LEG_M
    wind_per_m = np.sqrt(np.einsum("ki,ij,kj->k", gradients, model.wind_cov_ne_m2ps2, gradients))
    last = model.energy.leg_costs_wind_major((cruises[0], land), wind[None, :])  # includes the stop
    land_wh = float(last.energy_wh[0, 1])
    budget_wh = _energy_above_reserve_wh(model, payload_kg, remaining_wh) - land_wh
    std_wh = model.airframe.battery.usable_std_frac * remaining_wh
    error = model.airframe.power_rotor.model_std_frac
    feasible = costs.feasible[0]

    def radius_m(direction_index: int) -> float:
        def spare_wh(distance_m: float) -> float:
            errors = (
                wind_per_m[direction_index] * distance_m,
                error * (per_m[direction_index] * distance_m + land_wh),
                std_wh,
            )
            return (
                budget_wh - per_m[direction_index] * distance_m - model.sigmas * math.hypot(*errors)
            )

        return (
            find_max_feasible_distance_m(spare_wh, MAX_RADIUS_M)
            if feasible[direction_index]
            else 0.0
        )

    return np.array([radius_m(k) for k in range(len(directions_ne))])


def _energy_above_reserve_wh(
    model: SortieFeasibility, payload_kg: float, remaining_wh: float
) -> float:
    """Return the energy left above the reserve."""
    battery, drone = model.airframe.battery, model.drone
    draw_w = model.energy.hover_power_w(payload_kg)
    full_wh = battery.usable_energy_of_full_pack_wh(
        draw_w, drone.temperature_c, drone.battery_health_frac
    )
    return remaining_wh - model.mission.reserve_frac * full_wh
