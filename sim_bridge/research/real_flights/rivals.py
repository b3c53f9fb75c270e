"""Plainer models of a flight's energy, fitted to the same flights: what ours has to beat."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.measured_energy.flown_track import STEP_S
from companion.core.measured_energy.track_power import PHASES, phases
from sim_bridge.research.real_flights.folder import ReadFlight

CONSTANT, BY_PAYLOAD, PUBLISHED = "constant power", "power by payload", "Rodrigues et al. 2022"

EMPTY_KG = 3.68
"""The aircraft with pack and sensors (Rodrigues et al. 2021)."""

PUBLISHED_SLOPES = (80.4, 68.9, 71.5)
PUBLISHED_W = (13.8, 16.8, -24.3)
"""Of climb, cruise and descent: `P = slope * m^1.5 / sqrt(density) + constant` (Rodrigues et al.,
Patterns 3, 100569, 2022). Fitted by them to this very campaign, judged days included."""


@dataclass(frozen=True, slots=True)
class Rivals:
    """Mean power, and power with its slope over payload, of the fitting flights."""

    constant_w: float
    empty_w: float
    payload_w_per_kg: float

    def predicted_wh(self, flight: ReadFlight) -> dict[str, float]:
        """Energy of one flight by each model; its duration is known, as to the airframe's model."""
        payload_kg = flight.ordered.payload_kg
        hours = len(flight.track.t_s) * STEP_S / 3600.0
        return {
            CONSTANT: self.constant_w * hours,
            BY_PAYLOAD: (self.empty_w + self.payload_w_per_kg * payload_kg) * hours,
            PUBLISHED: _published_wh(flight),
        }


def fit_rivals(flights: Sequence[ReadFlight]) -> Rivals:
    """Least squares over the flights' mean powers."""
    power = np.array([float(f.track.power_w.mean()) for f in flights])
    payload = np.array([f.ordered.payload_kg for f in flights])
    slope, empty = (0.0, float(power.mean()))
    if float(np.ptp(payload)) > 0.0:
        slope, empty = (float(one) for one in np.polyfit(payload, power, 1))
    return Rivals(float(power.mean()), empty, slope)


def published_w(mass_kg: float, density_kgpm3: float) -> Floats:
    """Power in climb, cruise and descent, W, in the order of PHASES."""
    load = mass_kg**1.5 / math.sqrt(density_kgpm3)
    return np.array(PUBLISHED_SLOPES) * load + np.array(PUBLISHED_W)


def _published_wh(flight: ReadFlight) -> float:
    """Each phase at its own power."""
    seconds = np.bincount(phases(flight.track), minlength=len(PHASES)) * STEP_S
    power = published_w(EMPTY_KG + flight.ordered.payload_kg, flight.density_kgpm3)
    return float(seconds @ power) / 3600.0
