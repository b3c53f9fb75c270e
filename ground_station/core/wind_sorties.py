"""Sorties priced by the energy model that the vehicles fly with, under a believed wind.

Each leg is charged its mean and `sigmas` times its own standard deviation from the wind's error.
One wind error moves both legs, and the deviation of a sum is at most the sum of the deviations:
what fits here keeps the accepted loss. Energy stands as seconds of hover without a parcel in that
wind.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from companion.core.route_energy import Leg, LegKind, RouteEnergy
from ground_station.core.truck_drones.problem import Floats, Legs

COURSES = 360
PROBE_M = 1000.0
PAYLOAD_STEP_KG = 0.1


@dataclass(frozen=True, slots=True)
class WindSortieParams:
    """The wind as believed, what a sortie may risk, and what it does beside flying."""

    wind_to_ne_mps: Floats
    wind_cov_ne_m2ps2: Floats
    max_loss: float
    reserve_frac: float
    cruise_height_m: float
    service_s: float


@dataclass(frozen=True, slots=True)
class _Rates:
    """By course: seconds and Wh a metre, the latter with its margin; and for going up and down."""

    s_per_m: Floats
    wh_per_m: Floats
    vertical_s: float
    vertical_wh: float


class WindSorties:
    """`SortieModel` over places in metres (north, east); one RouteEnergy and pack a kind."""

    def __init__(
        self,
        ne_m: Floats,
        payload_kg: Floats,
        kinds: Sequence[tuple[RouteEnergy, float, float]],
        params: WindSortieParams,
    ) -> None:
        """`kinds`: energy model, usable Wh and its standard deviation."""
        self._ne_m, self._payload_kg = ne_m, payload_kg
        self._kinds, self._params = kinds, params
        self._sigmas = float(ndtri(1.0 - params.max_loss))

    def legs(self, drone_kind: int) -> Legs:
        """Times and energies of this kind of drone between all places."""
        energy, usable_wh, usable_std_wh = self._kinds[drone_kind]
        wind_mps = float(np.hypot(*self._params.wind_to_ne_mps))
        hover_wh_per_s = energy.power_w(0.0, wind_mps) / 3600.0
        away_m = self._ne_m[None, :, :] - self._ne_m[:, None, :]
        # Not 0, for an impossible course times no way is no number.
        length_m = np.maximum(np.hypot(away_m[..., 0], away_m[..., 1]), 1e-6)
        turn = np.arctan2(away_m[..., 1], away_m[..., 0]) / (2.0 * np.pi) * COURSES
        course = np.rint(turn).astype(np.int64) % COURSES
        out_s, out_wh = np.empty_like(length_m), np.empty_like(length_m)
        steps = np.ceil(self._payload_kg / PAYLOAD_STEP_KG - 1e-9).astype(np.int64)
        for step in np.unique(steps).tolist():
            rates = self._rates(energy, step * PAYLOAD_STEP_KG)
            to = steps == step
            out_s[:, to] = rates.vertical_s + (length_m * rates.s_per_m[course])[:, to]
            out_wh[:, to] = rates.vertical_wh + (length_m * rates.wh_per_m[course])[:, to]
        empty = self._rates(energy, 0.0)
        back_wh = empty.vertical_wh + length_m * empty.wh_per_m[course]
        sure_wh = usable_wh * (1.0 - self._params.reserve_frac) - self._sigmas * usable_std_wh
        return Legs(
            out_s=out_s + self._params.service_s,
            back_s=empty.vertical_s + length_m * empty.s_per_m[course],
            out_hover_s=out_wh / hover_wh_per_s,
            back_hover_s=back_wh / hover_wh_per_s,
            endurance_hover_s=max(0.0, sure_wh / hover_wh_per_s),
        )

    def _rates(self, energy: RouteEnergy, payload_kg: float) -> _Rates:
        params = self._params
        top = (0.0, 0.0, -params.cruise_height_m)
        angles = np.arange(COURSES) * (2.0 * np.pi / COURSES)
        ends = [
            (PROBE_M * float(np.cos(angle)), PROBE_M * float(np.sin(angle)), top[2])
            for angle in angles
        ]
        probes = tuple(Leg(LegKind.CRUISE, top, end, payload_kg) for end in ends)
        cruise_s, cruise_wh = self._priced(energy, probes)
        ups = (
            Leg(LegKind.CLIMB, (0.0, 0.0, 0.0), top, payload_kg),
            Leg(LegKind.LAND, top, (0.0, 0.0, 0.0), payload_kg),
        )
        vertical_s, vertical_wh = self._priced(energy, ups)
        return _Rates(
            cruise_s / PROBE_M,
            cruise_wh / PROBE_M,
            float(vertical_s.sum()),
            float(vertical_wh.sum()),
        )

    def _priced(self, energy: RouteEnergy, legs: tuple[Leg, ...]) -> tuple[Floats, Floats]:
        """Time, and energy with its margin, of each leg by itself; inf where no way is made."""
        params = self._params
        compiled = energy.compile(legs, (None,) * len(legs))
        costs = energy.costs(compiled, params.wind_to_ne_mps[None, :])
        gradient = energy.gradient_wh_per_mps(compiled, params.wind_to_ne_mps)
        std_wh = np.sqrt(
            np.maximum(np.einsum("li,ij,lj->l", gradient, params.wind_cov_ne_m2ps2, gradient), 0.0)
        )
        sure_wh = np.where(costs.feasible[0], costs.energy_wh[0] + self._sigmas * std_wh, np.inf)
        return costs.time_s[0], sure_wh
