"""The multirotor power model's numbers, from voltage times current in settled flight.

Fits `power.multirotor_power_w` itself, the very model that plans, with the airspeed that the drag
fit saw. Descents are left out (the model prices them as level flight, and they tell nothing of
it); so is flight sideways through the air, where the model's nose-on drag does not hold. Each
flight has a factor of its own for its current sensor's scale.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_array

from companion.core.base.arrays import Floats, Ints
from companion.core.calibration.drag import DRAG_KEYS, WindSeen
from companion.core.calibration.records import Blocks
from companion.core.calibration.residual_scatter import by_minute, widened_covariance
from companion.core.calibration.standing import (
    StandingPower,
    least_drawing,
    pooled,
    standing_in,
)
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

POWER_KEYS = ("induced_factor", "drive_efficiency", "blade_drag_coefficient", "avionics_w")
"""Of the table power_rotor, in the order of the fitted values."""
VERTICAL_KEY = "vertical_quadratic_n_per_mps2"
"""Of the table drag: the fifth value where the start airframe states it, else left out. Tilt tells
nothing of it (it lies along the thrust), power in fast flight does."""
LEAST_VALUES = (1.0, 0.2, 0.0, 0.0, 0.0)
"""What `power_values` can be at the least, and _HIGH at the most."""
_HIGH = (2.0, 1.0, 0.5, 5000.0, 50.0)
_LEAST_PRIOR_STD = (0.05, 0.02, 0.005, 2.0, 0.01)
_SETTLED_MPS2 = 1.0  # acceleration below which a block's power is taken, corrected for it
_SWING_MPS2 = 2.0  # thrust may move so much within such a block: gusts
_DESCENT_MPS = -0.4
_SIDEWAYS_FRAC = 0.6
_SIDEWAYS_FREE_MPS = 2.5


@dataclass(frozen=True, slots=True)
class PowerPriors:
    """How wrong the start airframe's power may be, relative; and the sensors. [est]"""

    induced_frac: float = 0.15
    efficiency_frac: float = 0.15
    blade_frac: float = 0.6
    avionics_frac: float = 0.6
    vertical_frac: float = 0.6
    sensor_scale_std: float = 0.02
    current_offset_std_a: float = 0.2
    model_frac: float = 0.03

    def stds(self, values: Floats) -> Floats:
        """Standard deviations about these values, in the order of `power_values`."""
        fracs = [self.induced_frac, self.efficiency_frac, self.blade_frac, self.avionics_frac]
        fracs += [self.vertical_frac]
        count = len(values)
        return np.maximum(np.array(fracs[:count]) * values, _LEAST_PRIOR_STD[:count])


@dataclass(frozen=True, slots=True)
class PowerFit:
    """`values` and `cov` in the order of `power_values`. Per flight: its settled blocks' indices,
    the measured over expected power there, less 1, and the sensor's factor. `standing`: power with
    the motors off as the sensor reads it, over all logs."""

    values: Floats
    cov: Floats
    prior_cov: Floats
    sensor_scale: tuple[float, ...]
    settled: tuple[Ints, ...]
    residual_frac: tuple[Floats, ...]
    standing: StandingPower | None = None


def power_keys(airframe: Airframe) -> list[tuple[str, str]]:
    """Table and key of each of `power_values`."""
    keys = [("power_rotor", key) for key in POWER_KEYS]
    stated = airframe.drag.vertical_quadratic_n_per_mps2 is not None
    return [*keys, ("drag", VERTICAL_KEY)] if stated else keys


def power_values(airframe: Airframe) -> Floats:
    """The airframe's own numbers: those of POWER_KEYS, then VERTICAL_KEY's where it is stated."""
    own = [getattr(airframe.power_rotor, key) for key in POWER_KEYS]
    vertical = airframe.drag.vertical_quadratic_n_per_mps2
    return np.array(own if vertical is None else [*own, vertical])


def with_values(airframe: Airframe, drag: Floats, power: Floats) -> Airframe:
    """An airframe with these numbers of DRAG_KEYS and of `power_values` in it."""
    changed = msgspec.structs.replace
    count = len(POWER_KEYS)
    of_rotor, vertical = map(float, power[:count]), map(float, power[count:])
    rotor = changed(airframe.power_rotor, **dict(zip(POWER_KEYS, of_rotor, strict=True)))
    drags = dict(zip(DRAG_KEYS, map(float, drag), strict=True))
    own = changed(airframe.drag, **drags, **dict(zip((VERTICAL_KEY,), vertical, strict=False)))
    return changed(airframe, drag=own, power_rotor=rotor)


def air_speeds(blocks: Blocks, wind: WindSeen) -> tuple[Floats, Floats]:
    """Airspeed (horizontal) and its part across the heading over a flight's airborne blocks."""
    b = blocks.pick(blocks.airborne)
    air_n, air_e = b.north_mps - wind.to_north_mps, b.east_mps - wind.to_east_mps
    return np.hypot(air_n, air_e), np.abs(b.cos_yaw * air_e - b.sin_yaw * air_n)


def predicted_w(airframe: Airframe, blocks: Blocks, wind: WindSeen) -> Floats:
    """Power by the airframe over a flight's airborne blocks, as the companion would plan it."""
    return _priced_w(airframe, blocks.pick(blocks.airborne), air_speeds(blocks, wind)[0])


def _priced_w(airframe: Airframe, b: Blocks, airspeed_mps: Floats) -> Floats:
    power = np.zeros_like(airspeed_mps)
    for payload_kg in np.unique(b.payload_kg):
        at = b.payload_kg == payload_kg
        mass_kg = airframe.mass_kg(float(payload_kg))
        power[at] = multirotor_power_w(
            airframe, mass_kg, airspeed_mps[at], b.climb_mps[at], b.density_kgpm3
        )
    return power


@dataclass(frozen=True, slots=True)
class _Piece:
    """One flight's settled blocks with what does not change while the fit goes on."""

    blocks: Blocks
    airspeed_mps: Floats
    kinetic_w: Floats
    noise_w: Floats

    @staticmethod
    def of(
        blocks: Blocks,
        wind: WindSeen,
        settled: Ints,
        airframe: Airframe,
        priors: PowerPriors,
    ) -> "_Piece":
        """The settled ones among a flight's airborne blocks."""
        return _Piece(
            blocks.pick(np.flatnonzero(blocks.airborne)[settled]),
            air_speeds(blocks, wind)[0][settled],
            _kinetic_w(blocks, wind, airframe)[settled],
            _noise(airframe, blocks, wind, priors)[settled],
        )

    def expected_w(self, airframe: Airframe) -> Floats:
        """Power by an airframe, what goes into speed included."""
        level = _priced_w(airframe, self.blocks, self.airspeed_mps)
        return level + self.kinetic_w / airframe.power_rotor.drive_efficiency


def fit_power(
    flights: list[Blocks],
    winds: list[WindSeen],
    airframe: Airframe,
    priors: PowerPriors | None = None,
    ground: Sequence[StandingPower] = (),
) -> PowerFit:
    """Power from flights whose wind is seen; `airframe` is the prior, with its drag fitted.

    `ground`: tests on the ground beside them. They are told of, and not fitted to: with avionics as
    believed the energy to go of held-out M100 days was 0.05 points worse.
    """
    p = priors or PowerPriors()
    start = power_values(airframe)
    count = len(start)
    stds = p.stds(start)
    flown = [b.pick(b.airborne) for b in flights]
    settled = [_settled(b, w) for b, w in zip(flights, winds, strict=True)]
    at_rest = [standing_in(b, airframe) for b in flights]
    known = [one for one in at_rest if one is not None]
    standing = pooled([*known, *least_drawing(ground, p.current_offset_std_a)])
    drag = np.array([getattr(airframe.drag, key) for key in DRAG_KEYS])
    pieces = [
        _Piece.of(b, w, at, airframe, p) for b, w, at in zip(flights, winds, settled, strict=True)
    ]

    def residuals(x: Floats) -> Floats:
        tried = with_values(airframe, drag, x[:count])
        parts = [
            (piece.blocks.power_w - piece.expected_w(tried) * (1.0 + scale)) / piece.noise_w
            for piece, scale in zip(pieces, x[count:], strict=True)
        ]
        for i, seen in enumerate(at_rest):
            if seen is not None:
                std_w = math.hypot(p.current_offset_std_a * seen.voltage_v, seen.std_w)
                parts.append([(seen.power_w - x[3] * (1.0 + x[count + i])) / std_w])
        parts.append((x[:count] - start) / stds)
        parts.append(x[count:] / p.sensor_scale_std)
        return np.concatenate(parts)

    least, most = np.array(LEAST_VALUES[:count]), np.array(_HIGH[:count])
    x0 = np.r_[np.clip(start, least + 1e-6, most), np.zeros(len(flights))]
    low = np.r_[least, np.full(len(flights), -0.3)]
    high = np.r_[most, np.full(len(flights), 0.3)]
    solution = least_squares(
        residuals,
        x0,
        bounds=(low, high),
        x_scale=np.r_[stds, np.full(len(flights), 0.02)],
        loss="soft_l1",
        f_scale=2.0,
        jac_sparsity=_pattern([len(p.noise_w) for p in pieces], at_rest, count),
    )
    x = solution.x
    cov = widened_covariance(solution.jac.toarray(), residuals(x), _clusters(flown, settled))
    tried = with_values(airframe, drag, x[:count])
    left = tuple(
        piece.blocks.power_w / (piece.expected_w(tried) * (1.0 + scale)) - 1.0
        for piece, scale in zip(pieces, x[count:], strict=True)
    )
    return PowerFit(
        values=x[:count],
        cov=cov[:count, :count],
        prior_cov=np.diag(stds**2),
        sensor_scale=tuple(1.0 + x[count:]),
        settled=tuple(settled),
        residual_frac=left,
        standing=standing,
    )


def _pattern(rows: list[int], at_rest: Sequence[object], shared: int) -> lil_array:
    """Which residual depends on what: a flight's on the power's values and on its own sensor's."""
    flights = len(rows)
    own = [i for i, count in enumerate(rows) for _ in range(count)]
    own += [i for i, seen in enumerate(at_rest) if seen is not None]
    pattern = lil_array((len(own) + shared + flights, shared + flights))
    pattern[: len(own), :shared] = 1
    pattern[np.arange(len(own)), shared + np.array(own)] = 1
    last = np.arange(shared + flights)
    pattern[len(own) + last, last] = 1
    return pattern


def _settled(blocks: Blocks, wind: WindSeen) -> Ints:
    """Airborne blocks in steady flight nose-on: level, climbing or hovering."""
    b = blocks.pick(blocks.airborne)
    airspeed, across = air_speeds(blocks, wind)
    steady = (b.swing_mps2 < _SWING_MPS2) & (b.climb_mps > _DESCENT_MPS)
    accel = np.hypot(b.accel_forward_mps2, b.accel_right_mps2)
    nose_on = across < np.maximum(_SIDEWAYS_FRAC * airspeed, _SIDEWAYS_FREE_MPS)
    return np.flatnonzero(steady & nose_on & (accel < _SETTLED_MPS2))


def _kinetic_w(blocks: Blocks, wind: WindSeen, airframe: Airframe) -> Floats:
    """Shaft power that goes into speed: mass times acceleration times velocity through the air."""
    b = blocks.pick(blocks.airborne)
    air_n, air_e = b.north_mps - wind.to_north_mps, b.east_mps - wind.to_east_mps
    forward, right = b.cos_yaw * air_n + b.sin_yaw * air_e, b.cos_yaw * air_e - b.sin_yaw * air_n
    gained = b.accel_forward_mps2 * forward + b.accel_right_mps2 * right
    return (airframe.mass.empty_kg + b.payload_kg) * gained


def _noise(airframe: Airframe, blocks: Blocks, wind: WindSeen, p: PowerPriors) -> Floats:
    """Standard deviation of one block's power: the model's, and what the wind's error makes."""
    flown = blocks.pick(blocks.airborne)
    power = predicted_w(airframe, blocks, wind)
    shifted = replace(
        wind,
        to_north_mps=wind.to_north_mps + 0.5 * wind.std_mps,
        to_east_mps=wind.to_east_mps + 0.5 * wind.std_mps,
    )
    slope = predicted_w(airframe, blocks, shifted) - power
    return np.hypot(p.model_frac * flown.power_w, slope)


def _clusters(flown: list[Blocks], settled: list[Ints]) -> Iterator[Ints]:
    """Settled rows of all flights, minute by minute."""
    at = 0
    for b, rows in zip(flown, settled, strict=True):
        yield from by_minute(b.t_s[rows], at)
        at += len(rows)
