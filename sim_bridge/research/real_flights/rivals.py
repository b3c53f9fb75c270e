"""Plainer models of a flight's energy, fitted to the same flights: what ours has to beat."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.measured_energy.flown_track import STEP_S
from companion.core.measured_energy.track_power import PHASES, phases
from sim_bridge.research.real_flights.folder import ReadFlight

CONSTANT, BY_PAYLOAD = "constant power", "power by payload"
INDUCED = "induced power by phase, fitted"
PUBLISHED = "induced power by phase, as published"

PUBLISHED_W: tuple[tuple[float, ...], ...] = ((80.4, 68.9, 71.5), (13.8, 16.8, -24.3))
"""Of climb, level and descent: watts per `kg^1.5 / sqrt(kg/m3)`, and watts. Rodrigues et al.,
Patterns 3, 100569, 2022: take-off, cruise and landing of this very aircraft and campaign, the days
that are judged here among them. The form is that of the authors' code; the numbers are quoted at
second hand and not checked against the paper's table."""

EMPTY_KG = 3.68
"""The aircraft with pack and sensors (Rodrigues et al. 2021)."""


@dataclass(frozen=True, slots=True)
class Rivals:
    """Mean power, power with its slope over payload, and by phase, of the fitting flights.

    `induced_w` (2, phases): of climb, level and descent the slope over `m^1.5 / sqrt(density)`, the
    induced power of momentum theory, and a constant; the form of Rodrigues et al. (Patterns 3,
    100569, 2022), with our own fit.
    """

    constant_w: float
    empty_w: float
    payload_w_per_kg: float
    induced_w: Floats

    def predicted_wh(self, flight: ReadFlight) -> dict[str, float]:
        """Energy of one flight by each model; its duration is known, as to the airframe's model."""
        payload_kg = flight.ordered.payload_kg
        hours = len(flight.track.t_s) * STEP_S / 3600.0
        return {
            CONSTANT: self.constant_w * hours,
            BY_PAYLOAD: (self.empty_w + self.payload_w_per_kg * payload_kg) * hours,
            INDUCED: float(_by_phase(flight) @ self.induced_w.ravel()) / 3600.0,
            PUBLISHED: float(_by_phase(flight) @ np.ravel(PUBLISHED_W)) / 3600.0,
        }


def fit_rivals(flights: Sequence[ReadFlight]) -> Rivals:
    """Least squares over the flights' mean powers."""
    power = np.array([float(f.track.power_w.mean()) for f in flights])
    payload = np.array([f.ordered.payload_kg for f in flights])
    slope, empty = (0.0, float(power.mean()))
    if float(np.ptp(payload)) > 0.0:
        slope, empty = (float(one) for one in np.polyfit(payload, power, 1))
    by_phase = np.array([_by_phase(flight) for flight in flights])
    energy_j = power * np.array([len(f.track.t_s) * STEP_S for f in flights])
    induced, *_ = np.linalg.lstsq(by_phase, energy_j, rcond=None)
    shape = 2, len(PHASES)
    return Rivals(float(power.mean()), empty, slope, np.asarray(induced, float).reshape(shape))


def _by_phase(flight: ReadFlight) -> Floats:
    """(2 phases,): seconds in each phase, times the load, and as they are."""
    seconds = np.bincount(phases(flight.track), minlength=len(PHASES)) * STEP_S
    mass_kg = EMPTY_KG + flight.ordered.payload_kg
    load = mass_kg**1.5 / math.sqrt(flight.density_kgpm3)
    return np.concatenate([seconds * load, np.asarray(seconds, float)])
