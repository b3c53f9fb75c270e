"""How far a drone can still go and land, on the energy that it says is left."""

import math
from dataclasses import dataclass, field

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import moved_deg
from companion.core.routing.leg_energy import Leg, LegKind
from companion.fleet.messages import State
from ground_station.app.map.picture import Point
from ground_station.core.feasibility.reach import Reach, day_energy, last_that_fits, rounded_up
from ground_station.core.schema.day_data import DayData

BEARINGS = 48
SAMPLE_M = 1000.0
"""Length of the priced leg: its energy goes with its length, but for the stop at its end."""

FAR_M = 200_000.0


@dataclass(slots=True)
class ReachRings:
    """The rings of one day's drones."""

    data: DayData
    _models: dict[str, Reach] = field(default_factory=dict)

    def ring(self, state: State, payload_kg: float) -> list[Point] | None:
        """Points all around where it can still land on its reserve, at the accepted loss.

        A straight line at its height in the wind that it reports (else the forecast), with the
        forecast's error; obstacles are not looked at. None: its state lacks what it takes.
        """
        model, left_wh = self._model(state.vehicle), state.energy_left_wh
        if model is None or left_wh is None or state.lat_deg is None or state.lon_deg is None:
            return None
        bearings = np.linspace(0.0, 2.0 * math.pi, BEARINGS, endpoint=False)
        ways = np.column_stack([np.cos(bearings), np.sin(bearings)])
        far_m = _radii_m(model, state, rounded_up(payload_kg), left_wh, ways)
        lat, lon = moved_deg(state.lat_deg, state.lon_deg, *(far_m * ways.T))
        return list(zip(map(float, lat), map(float, lon), strict=True))

    def _model(self, vehicle: str) -> Reach | None:
        drone = self.data.day.drone(vehicle)
        if drone is None:
            return None
        if vehicle not in self._models:
            day, airframe = self.data.day, self.data.airframes[drone.airframe]
            energy = day_energy(day, airframe)
            self._models[vehicle] = Reach(drone, airframe, day.mission, day.forecast, energy)
        return self._models[vehicle]


def _radii_m(model: Reach, state: State, payload_kg: float, left_wh: float, ways: Floats) -> Floats:
    """The radius in each direction, (n, 2) unit vectors, metres."""
    up = -(state.height_rel_m or 0.0)
    wind = _wind(model, state)
    cruises = tuple(
        Leg(LegKind.CRUISE, (0.0, 0.0, up), (north * SAMPLE_M, east * SAMPLE_M, up), payload_kg)
        for north, east in ways
    )
    ends = cruises[0].to_ned_m
    land = Leg(LegKind.LAND, ends, (*ends[:2], 0.0), payload_kg)
    compiled = model.energy.compile(cruises, (None,) * len(cruises))
    costs = model.energy.costs(compiled, wind[None, :])
    per_m = costs.energy_wh[0] / SAMPLE_M
    gradients = model.energy.gradient_wh_per_mps(compiled, wind) / SAMPLE_M
    wind_per_m = np.sqrt(np.einsum("ki,ij,kj->k", gradients, model.wind_cov_ne_m2ps2, gradients))
    last = model.energy.costs((cruises[0], land), wind[None, :])  # with the stop before it
    land_wh = float(last.energy_wh[0, 1])
    budget_wh = _budget_wh(model, payload_kg, left_wh) - land_wh
    std_wh = model.airframe.battery.usable_std_frac * left_wh
    error = model.airframe.power_rotor.model_std_frac
    feasible = costs.feasible[0]

    def radius_m(k: int) -> float:
        def spare_wh(far_m: float) -> float:
            errors = (wind_per_m[k] * far_m, error * (per_m[k] * far_m + land_wh), std_wh)
            return budget_wh - per_m[k] * far_m - model.sigmas * math.hypot(*errors)

        return last_that_fits(spare_wh, FAR_M) if feasible[k] else 0.0

    return np.array([radius_m(k) for k in range(len(ways))])


def _wind(model: Reach, state: State) -> Floats:
    if state.wind_to_n_mps is None or state.wind_to_e_mps is None:
        return model.wind_to_ne_mps
    return np.array([state.wind_to_n_mps, state.wind_to_e_mps])


def _budget_wh(model: Reach, payload_kg: float, left_wh: float) -> float:
    """Energy left above the reserve."""
    battery, drone = model.airframe.battery, model.drone
    draw_w = model.energy.hover_power_w(payload_kg)
    full_wh = battery.usable_wh(draw_w, drone.temperature_c, drone.battery_health_frac)
    return left_wh - model.mission.reserve_frac * full_wh
