"""Parameters of the multirotor power model, from voltage times current in steady flight.

Fits `power.multirotor_power_w`, the model used for planning, at the airspeed of the drag fit.
Descents are excluded (the model treats them as level flight), and so is sideways flight through
the air, for which the model's nose-on drag is invalid. Each flight has a scale factor for its
current sensor.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_array

from companion.analysis.calibration.drag import DRAG_KEYS, EstimatedWind
from companion.analysis.calibration.ground_power import (
    StandingPower,
    lowest_current_tests,
    mean_standing_power,
    motors_off_power_before_flight,
)
from companion.analysis.calibration.records import Blocks
from companion.analysis.calibration.residual_scatter import (
    covariance_widened_by_cluster_scatter,
    row_indices_by_minute,
)
from companion.core.base.arrays import Floats, Ints
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

POWER_KEYS = ("induced_factor", "drive_efficiency", "blade_drag_coefficient", "avionics_w")
"""Keys of the table power_rotor, in the order of the fitted values."""
VERTICAL_KEY = "vertical_quadratic_n_per_mps2"
"""Key of the table drag: the fifth fitted value if the start airframe defines it. Power in fast
flight identifies it; tilt does not, because it acts along the thrust."""
MIN_VALUES = (1.0, 0.2, 0.0, 0.0, 0.0)
"""Lower bounds of `power_parameter_vector`; _HIGH has the upper bounds."""
MAX_VALUES = (2.0, 1.0, 0.5, 5000.0, 50.0)
_MIN_PRIOR_STD = (0.05, 0.02, 0.005, 2.0, 0.01)
_MAX_STEADY_ACCEL_MPS2 = 1.0  # maximum acceleration of a used block; its power is corrected for it
_MAX_THRUST_RANGE_MPS2 = 2.0  # maximum change of thrust within a used block: gusts
_MIN_CLIMB_MPS = -0.4
_SIDEWAYS_FRAC = 0.6
_SIDEWAYS_LIMIT_MPS = 2.5


@dataclass(frozen=True, slots=True)
class PowerPriors:
    """Relative uncertainty of the start airframe's power, and of the sensors. [est]"""

    induced_frac: float = 0.15
    efficiency_frac: float = 0.15
    blade_frac: float = 0.6
    avionics_frac: float = 0.6
    vertical_frac: float = 0.6
    sensor_scale_std: float = 0.02
    current_offset_std_a: float = 0.2
    model_frac: float = 0.03

    def prior_std_by_value(self, values: Floats) -> Floats:
        """Return prior standard deviations, in the order of `power_parameter_vector`."""
        fracs = [self.induced_frac, self.efficiency_frac, self.blade_frac, self.avionics_frac]
        fracs += [self.vertical_frac]
        count = len(values)
        return np.maximum(np.array(fracs[:count]) * values, _MIN_PRIOR_STD[:count])


@dataclass(frozen=True, slots=True)
class PowerFit:
    """`values` and `cov` in the order of `power_parameter_vector`; `sensor_scale` per flight.
    `standing`: measured power with the motors off, over all logs."""

    values: Floats
    cov: Floats
    prior_cov: Floats
    sensor_scale: tuple[float, ...]
    standing: StandingPower | None = None


def power_parameter_table_keys(airframe: Airframe) -> list[tuple[str, str]]:
    """Return table and key of each of `power_parameter_vector`."""
    keys = [("power_rotor", key) for key in POWER_KEYS]
    has_vertical_drag = airframe.drag.vertical_quadratic_n_per_mps2 is not None
    return [*keys, ("drag", VERTICAL_KEY)] if has_vertical_drag else keys


def power_parameter_vector(airframe: Airframe) -> Floats:
    """Return the airframe's values of POWER_KEYS, then of VERTICAL_KEY if defined."""
    own = [getattr(airframe.power_rotor, key) for key in POWER_KEYS]
    vertical = airframe.drag.vertical_quadratic_n_per_mps2
    return np.array(own if vertical is None else [*own, vertical])


def with_drag_and_power_parameters(
    airframe: Airframe, drag_parameters: Floats, power_parameters: Floats
) -> Airframe:
    """Return the airframe with these values of DRAG_KEYS and `power_parameter_vector`."""
    changed = msgspec.structs.replace
    count = len(POWER_KEYS)
    of_rotor, vertical = map(float, power_parameters[:count]), map(float, power_parameters[count:])
    rotor = changed(airframe.power_rotor, **dict(zip(POWER_KEYS, of_rotor, strict=True)))
    drags = dict(zip(DRAG_KEYS, map(float, drag_parameters), strict=True))
    own = changed(airframe.drag, **drags, **dict(zip((VERTICAL_KEY,), vertical, strict=False)))
    return changed(airframe, drag=own, power_rotor=rotor)


def airspeed_and_lateral_part_mps(blocks: Blocks, wind: EstimatedWind) -> tuple[Floats, Floats]:
    """Return horizontal airspeed and its lateral part over a flight's airborne blocks."""
    b = blocks.select(blocks.airborne)
    air_n, air_e = b.north_mps - wind.to_north_mps, b.east_mps - wind.to_east_mps
    return np.hypot(air_n, air_e), np.abs(b.cos_yaw * air_e - b.sin_yaw * air_n)


def predicted_airborne_power_w(airframe: Airframe, blocks: Blocks, wind: EstimatedWind) -> Floats:
    """Return the modelled power over a flight's airborne blocks, as used for planning."""
    return _modelled_power_w(
        airframe, blocks.select(blocks.airborne), airspeed_and_lateral_part_mps(blocks, wind)[0]
    )


def _modelled_power_w(airframe: Airframe, b: Blocks, airspeed_mps: Floats) -> Floats:
    power = np.zeros_like(airspeed_mps)
    for payload_kg in np.unique(b.payload_kg):
        at = b.payload_kg == payload_kg
        mass_kg = airframe.flying_mass_kg(float(payload_kg))
        power[at] = multirotor_power_w(
            airframe, mass_kg, airspeed_mps[at], b.climb_mps[at], b.density_kgpm3
        )
    return power


@dataclass(frozen=True, slots=True)
class _SteadyBlocks:
    """One flight's steady blocks, with the quantities that are constant during the fit."""

    blocks: Blocks
    airspeed_mps: Floats
    acceleration_power_w: Floats
    power_std_w: Floats

    @staticmethod
    def from_flight(
        blocks: Blocks,
        wind: EstimatedWind,
        steady_indices: Ints,
        airframe: Airframe,
        priors: PowerPriors,
    ) -> "_SteadyBlocks":
        """Select the steady blocks among a flight's airborne blocks."""
        return _SteadyBlocks(
            blocks.select(np.flatnonzero(blocks.airborne)[steady_indices]),
            airspeed_and_lateral_part_mps(blocks, wind)[0][steady_indices],
            _acceleration_power_w(blocks, wind, airframe)[steady_indices],
            _power_std_w(airframe, blocks, wind, priors)[steady_indices],
        )

    def expected_power_w(self, airframe: Airframe) -> Floats:
        """Return the modelled power, including the power of acceleration."""
        level = _modelled_power_w(airframe, self.blocks, self.airspeed_mps)
        return level + self.acceleration_power_w / airframe.power_rotor.drive_efficiency


def fit_power(
    flights: list[Blocks],
    winds: list[EstimatedWind],
    airframe: Airframe,
    priors: PowerPriors | None = None,
    standing_power_tests: Sequence[StandingPower] = (),
) -> PowerFit:
    """Fit power to flights with known wind; `airframe` is the prior, with fitted drag.

    `standing_power_tests`: tests on the ground. They are reported and not used in the fit: with the
    prior avionics power the remaining energy of held-out M100 days was 0.05 points worse.
    """
    p = priors or PowerPriors()
    start = power_parameter_vector(airframe)
    count = len(start)
    stds = p.prior_std_by_value(start)
    flown = [b.select(b.airborne) for b in flights]
    steady_indices = [_steady_block_indices(b, w) for b, w in zip(flights, winds, strict=True)]
    at_rest = [motors_off_power_before_flight(b, airframe) for b in flights]
    known = [one for one in at_rest if one is not None]
    standing = mean_standing_power(
        [*known, *lowest_current_tests(standing_power_tests, p.current_offset_std_a)]
    )
    drag = np.array([getattr(airframe.drag, key) for key in DRAG_KEYS])
    steady_flights = [
        _SteadyBlocks.from_flight(b, w, at, airframe, p)
        for b, w, at in zip(flights, winds, steady_indices, strict=True)
    ]

    def weighted_residuals_and_priors(x: Floats) -> Floats:
        candidate = with_drag_and_power_parameters(airframe, drag, x[:count])
        parts = [
            (
                steady_blocks.blocks.power_w
                - steady_blocks.expected_power_w(candidate) * (1.0 + scale)
            )
            / steady_blocks.power_std_w
            for steady_blocks, scale in zip(steady_flights, x[count:], strict=True)
        ]
        for i, seen in enumerate(at_rest):
            if seen is not None:
                std_w = math.hypot(p.current_offset_std_a * seen.voltage_v, seen.std_w)
                parts.append([(seen.power_w - x[3] * (1.0 + x[count + i])) / std_w])
        parts.append((x[:count] - start) / stds)
        parts.append(x[count:] / p.sensor_scale_std)
        return np.concatenate(parts)

    least, most = np.array(MIN_VALUES[:count]), np.array(MAX_VALUES[:count])
    x0 = np.r_[np.clip(start, least + 1e-6, most), np.zeros(len(flights))]
    low = np.r_[least, np.full(len(flights), -0.3)]
    high = np.r_[most, np.full(len(flights), 0.3)]
    solution = least_squares(
        weighted_residuals_and_priors,
        x0,
        bounds=(low, high),
        x_scale=np.r_[stds, np.full(len(flights), 0.02)],
        loss="soft_l1",
        f_scale=2.0,
        jac_sparsity=_jacobian_sparsity(
            [len(p.power_std_w) for p in steady_flights], at_rest, count
        ),
    )
    x = solution.x
    cov = covariance_widened_by_cluster_scatter(
        solution.jac.toarray(),
        weighted_residuals_and_priors(x),
        _steady_row_indices_by_minute(flown, steady_indices),
    )
    return PowerFit(
        values=x[:count],
        cov=cov[:count, :count],
        prior_cov=np.diag(stds**2),
        sensor_scale=tuple(1.0 + x[count:]),
        standing=standing,
    )


def _jacobian_sparsity(
    residual_count_by_flight: list[int],
    standing_power_by_flight: Sequence[object],
    shared_parameter_count: int,
) -> lil_array:
    """Sparsity of the Jacobian: residuals depend on the power values and on one sensor's scale."""
    flights = len(residual_count_by_flight)
    own = [i for i, count in enumerate(residual_count_by_flight) for _ in range(count)]
    own += [i for i, seen in enumerate(standing_power_by_flight) if seen is not None]
    pattern = lil_array(
        (len(own) + shared_parameter_count + flights, shared_parameter_count + flights)
    )
    pattern[: len(own), :shared_parameter_count] = 1
    pattern[np.arange(len(own)), shared_parameter_count + np.array(own)] = 1
    last = np.arange(shared_parameter_count + flights)
    pattern[len(own) + last, last] = 1
    return pattern


def _steady_block_indices(blocks: Blocks, wind: EstimatedWind) -> Ints:
    """Return the airborne blocks in steady nose-on flight: level, climb or hover."""
    b = blocks.select(blocks.airborne)
    airspeed, across = airspeed_and_lateral_part_mps(blocks, wind)
    steady = (b.swing_mps2 < _MAX_THRUST_RANGE_MPS2) & (b.climb_mps > _MIN_CLIMB_MPS)
    accel = np.hypot(b.accel_forward_mps2, b.accel_right_mps2)
    nose_on = across < np.maximum(_SIDEWAYS_FRAC * airspeed, _SIDEWAYS_LIMIT_MPS)
    return np.flatnonzero(steady & nose_on & (accel < _MAX_STEADY_ACCEL_MPS2))


def _acceleration_power_w(blocks: Blocks, wind: EstimatedWind, airframe: Airframe) -> Floats:
    """Return the shaft power of acceleration: mass times acceleration times air velocity."""
    b = blocks.select(blocks.airborne)
    air_n, air_e = b.north_mps - wind.to_north_mps, b.east_mps - wind.to_east_mps
    forward, right = b.cos_yaw * air_n + b.sin_yaw * air_e, b.cos_yaw * air_e - b.sin_yaw * air_n
    gained = b.accel_forward_mps2 * forward + b.accel_right_mps2 * right
    return (airframe.mass.empty_kg + b.payload_kg) * gained


def _power_std_w(
    airframe: Airframe, blocks: Blocks, wind: EstimatedWind, priors: PowerPriors
) -> Floats:
    """Return the std of one block's power, from model error and wind error."""
    flown = blocks.select(blocks.airborne)
    power = predicted_airborne_power_w(airframe, blocks, wind)
    shifted = replace(
        wind,
        to_north_mps=wind.to_north_mps + 0.5 * wind.std_mps,
        to_east_mps=wind.to_east_mps + 0.5 * wind.std_mps,
    )
    slope = predicted_airborne_power_w(airframe, blocks, shifted) - power
    return np.hypot(priors.model_frac * flown.power_w, slope)


def _steady_row_indices_by_minute(
    flown: list[Blocks], steady_indices: list[Ints]
) -> Iterator[Ints]:
    """Yield the steady rows of each minute of all flights."""
    at = 0
    for b, rows in zip(flown, steady_indices, strict=True):
        yield from row_indices_by_minute(b.t_s[rows], at)
        at += len(rows)
