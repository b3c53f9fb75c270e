"""Modelled power over a flown track, and the ratio of measured to modelled energy by phase."""

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.analysis.calibration.drag import EstimatedWind
from companion.analysis.calibration.records import Blocks
from companion.analysis.measured_energy.flown_track import STEP_S, FlownTrack
from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe, FlownPower
from companion.core.vehicle.power import multirotor_power_w

PHASES = ("climb", "level", "descent")
_CLIMB, _LEVEL, _DESCENT = range(3)
_MIN_VERTICAL_MPS = 0.5
"""Limit of level flight: vertical velocity of a hover in gusts is below it."""
_MIN_FRAC, _MAX_FRAC = 0.5, 2.0


@dataclass(frozen=True, slots=True)
class PhaseEnergy:
    """Measured and modelled energy of one flight in each of PHASES, Wh, (3,) each."""

    measured_wh: Floats
    modelled_wh: Floats


def modelled_track_power_w(
    airframe: Airframe, track: FlownTrack, wind_to_ne_mps: Floats, density_kgpm3: float
) -> Floats:
    """Return electrical power at each grid point, for a wind (2,) or (n, 2) (direction to)."""
    wind = np.broadcast_to(wind_to_ne_mps, (len(track.t_s), 2))
    airspeed = np.hypot(track.vel_n_mps - wind[:, 0], track.vel_e_mps - wind[:, 1])
    mass_kg = airframe.flying_mass_kg(track.payload_kg)
    return multirotor_power_w(airframe, mass_kg, airspeed, track.climb_mps, density_kgpm3)


def wind_on_track_grid(track: FlownTrack, blocks: Blocks, wind: EstimatedWind) -> Floats:
    """Return the wind of a flight's airborne blocks at each grid point, (n, 2) (direction to)."""
    t_s = blocks.t_s[blocks.airborne]
    components = (wind.to_north_mps, wind.to_east_mps)
    return np.column_stack([np.interp(track.t_s, t_s, component) for component in components])


def phase_index_by_grid_point(track: FlownTrack) -> Ints:
    """Return the index in PHASES of each grid point."""
    climb = track.climb_mps
    return np.where(
        climb > _MIN_VERTICAL_MPS, _CLIMB, np.where(climb < -_MIN_VERTICAL_MPS, _DESCENT, _LEVEL)
    )


def energy_by_phase(track: FlownTrack, modelled_w: Floats) -> PhaseEnergy:
    """Return measured and modelled energy of one flight by phase."""
    phase = phase_index_by_grid_point(track)
    return PhaseEnergy(
        _energy_by_phase_wh(phase, track.power_w), _energy_by_phase_wh(phase, modelled_w)
    )


def _energy_by_phase_wh(phase: Ints, power_w: Floats) -> Floats:
    return np.bincount(phase, power_w, len(PHASES)).astype(np.float64) * STEP_S / 3600.0


def measured_to_modelled_power_by_phase(flights: Iterable[PhaseEnergy]) -> FlownPower:
    """Return measured over modelled energy by phase, summed over all flights.

    Raises LeewayError for an implausible ratio: phase not flown, or another vehicle.
    """
    rows = list(flights)
    measured = np.sum([row.measured_wh for row in rows], axis=0)
    modelled = np.sum([row.modelled_wh for row in rows], axis=0)
    fracs = measured / np.maximum(modelled, 1e-9)
    for phase, frac in zip(PHASES, fracs, strict=True):
        if not _MIN_FRAC <= frac <= _MAX_FRAC:
            raise LeewayError(
                f"{phase}: measured over modelled energy is {frac:.2f}, {_MIN_FRAC:g} to"
                f" {_MAX_FRAC:g} expected: another airframe, or no flight with that phase"
            )
    return FlownPower(
        climb_frac=float(fracs[_CLIMB]),
        level_frac=float(fracs[_LEVEL]),
        descent_frac=float(fracs[_DESCENT]),
    )


def with_flown_power_ratios(airframe: Airframe, flown: FlownPower | None) -> Airframe:
    """Return the airframe with this `power_flown`."""
    return msgspec.structs.replace(airframe, power_flown=flown)
