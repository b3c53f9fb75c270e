"""Power over a flown track by the airframe's own model, and what flights drew over it by phase."""

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.measured_energy.flown_track import STEP_S, FlownTrack
from companion.core.vehicle.airframe import Airframe, FlownPower
from companion.core.vehicle.power import multirotor_power_w

PHASES = ("climb", "level", "descent")
_CLIMB, _LEVEL, _DESCENT = range(3)
_MOVES_MPS = 0.5
"""Slower is level: the vertical velocity of hovering vehicles in gusts stays under it."""
_LEAST_FRAC, _MOST_FRAC = 0.5, 2.0


@dataclass(frozen=True, slots=True)
class PhaseEnergy:
    """Measured and modelled energy of one flight in each of PHASES, Wh, (3,) each."""

    measured_wh: Floats
    modelled_wh: Floats


def track_power_w(
    airframe: Airframe, track: FlownTrack, wind_to_ne_mps: Floats, density_kgpm3: float
) -> Floats:
    """Electrical power at each grid point, in a wind (2,) or (n, 2) that the air moves to."""
    wind = np.broadcast_to(wind_to_ne_mps, (len(track.t_s), 2))
    airspeed = np.hypot(track.vel_n_mps - wind[:, 0], track.vel_e_mps - wind[:, 1])
    mass_kg = airframe.mass_kg(track.payload_kg)
    return multirotor_power_w(airframe, mass_kg, airspeed, track.climb_mps, density_kgpm3)


def phases(track: FlownTrack) -> Ints:
    """Index in PHASES of each grid point."""
    climb = track.climb_mps
    return np.where(climb > _MOVES_MPS, _CLIMB, np.where(climb < -_MOVES_MPS, _DESCENT, _LEVEL))


def phase_energy(track: FlownTrack, modelled_w: Floats) -> PhaseEnergy:
    """Energies of one flight by phase."""
    phase = phases(track)
    return PhaseEnergy(_by_phase(phase, track.power_w), _by_phase(phase, modelled_w))


def _by_phase(phase: Ints, power_w: Floats) -> Floats:
    return np.bincount(phase, power_w, len(PHASES)).astype(np.float64) * STEP_S / 3600.0


def fit_phases(flights: Iterable[PhaseEnergy]) -> FlownPower:
    """Measured over modelled energy of all flights together, phase by phase.

    LeewayError where a phase was not flown, or was by another vehicle.
    """
    rows = list(flights)
    measured = np.sum([row.measured_wh for row in rows], axis=0)
    modelled = np.sum([row.modelled_wh for row in rows], axis=0)
    fracs = measured / np.maximum(modelled, 1e-9)
    for phase, frac in zip(PHASES, fracs, strict=True):
        if not _LEAST_FRAC <= frac <= _MOST_FRAC:
            raise LeewayError(
                f"{phase}: measured over modelled energy is {frac:.2f}, {_LEAST_FRAC:g} to"
                f" {_MOST_FRAC:g} expected: another airframe, or no flight with that phase"
            )
    return FlownPower(
        climb_frac=float(fracs[_CLIMB]),
        level_frac=float(fracs[_LEVEL]),
        descent_frac=float(fracs[_DESCENT]),
    )


def with_flown(airframe: Airframe, flown: FlownPower | None) -> Airframe:
    """The airframe with this table in it, or without one."""
    return msgspec.structs.replace(airframe, power_flown=flown)
