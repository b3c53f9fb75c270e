"""Result quantities of a calibration in a pilot's terms, with their uncertainty.

Drag at two speeds, power in hover, cruise and at the fastest, the pack: single model parameters
may be correlated without harm. Each quantity names the flight that would identify it.
"""

from dataclasses import dataclass

import numpy as np

from companion.analysis.calibration.battery import BatteryFit
from companion.analysis.calibration.drag import DragFit
from companion.analysis.calibration.flight import square_speeds_mps
from companion.analysis.calibration.power import (
    MIN_VALUES,
    POWER_KEYS,
    PowerFit,
    PowerPriors,
    with_drag_and_power_parameters,
)
from companion.analysis.calibration.records import Blocks
from companion.core.base.arrays import Floats
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

_POSTERIOR_OVER_PRIOR = 0.6
_RESISTANCE_LIMIT_FRAC = 0.25
_UNMEASURED_USABLE_STD_FRAC = 0.1  # [est] of a pack without a discharge test
_RELATIVE_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity of the fit: value, posterior and prior std, and the limit on the std.

    `needed`: the calibration fails unless it is identified; others keep the start airframe's value.
    `limit_std`: absolute limit, for a quantity whose value may be zero.
    """

    name: str
    unit: str
    value: float
    std: float
    prior_std: float
    limit_frac: float
    needed: bool
    flight: str
    limit_std: float | None = None

    @property
    def is_identifiable(self) -> bool:
        """Whether the std is within the limit and clearly below the prior's."""
        limit = self.limit_frac * abs(self.value) if self.limit_std is None else self.limit_std
        is_within_limit = self.std <= limit
        return is_within_limit and self.std <= _POSTERIOR_OVER_PRIOR * self.prior_std


def build_quantities(
    flights: list[Blocks],
    prior_airframe: Airframe,
    drag: DragFit,
    power: PowerFit,
    battery: BatteryFit,
) -> tuple[Quantity, ...]:
    """Return all quantities of the fits, in display order."""
    slow, _, fast = square_speeds_mps(prior_airframe)
    cruise = prior_airframe.speeds.cruise_airspeed_mps
    found: list[Quantity] = []
    speeds = f"fly a square at two speeds, {slow:g} and {fast:g} m/s (companion calibrate-plan)"
    fixed = (
        "fly the square with the nose held on one heading (PX4 MPC_YAW_MODE 5, ArduPilot"
        " WP_YAW_BEHAVIOR 0)"
    )
    for axis, name, limit, needed, flight in (
        (0, "forward", 0.10, True, speeds),
        (1, "right", 0.15, False, fixed),
    ):
        for speed in (slow, cruise):
            row = np.zeros(5)
            row[axis], row[axis + 2] = speed, speed**2
            found.append(
                _drag_quantity(
                    f"drag {name} at {speed:g} m/s", "N", row, drag, limit, needed, flight
                )
            )
    row = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
    parcel = "fly the square once with a parcel and once without"
    found.append(_drag_quantity("parcel's drag", "N/(m/s)^2", row, drag, 0.5, False, parcel))
    found += _vertical_drag_quantities(power)
    fitted = with_drag_and_power_parameters(prior_airframe, drag.values, power.values)
    loaded_payload_kg = (
        max(float(b.payload_kg.max()) for b in flights) or prior_airframe.mass.max_payload_kg
    )
    hover = "hover for 30 s"
    loads = "fly the square with two loads, one near the largest"
    for name, payload, speed, limit, flight in (
        ("power in hover, empty", 0.0, 0.0, 0.05, hover),
        (f"power at {cruise:g} m/s, empty", 0.0, cruise, 0.05, speeds),
        (f"power in hover with {loaded_payload_kg:g} kg", loaded_payload_kg, 0.0, 0.05, loads),
    ):
        found.append(
            _level_flight_power_quantity(name, fitted, power, drag, payload, speed, limit, flight)
        )
    found.append(
        Quantity(
            "avionics",
            "W",
            float(power.values[3]),
            avionics_power_std_w(power),
            float(np.sqrt(power.prior_cov[3, 3])),
            1.0,
            False,
            _avionics_measurement_advice(power),
        )
    )
    found.append(
        Quantity(
            "pack's resistance",
            "ohm",
            battery.resistance_ohm,
            battery.resistance_std_ohm,
            0.5 * prior_airframe.battery.resistance_ohm,
            _RESISTANCE_LIMIT_FRAC,
            False,
            "log the pack at rest before take-off, and fly the square with a climb",
        )
    )
    found += _usable_energy_quantities(battery, prior_airframe)
    return tuple(found)


def avionics_power_std_w(power: PowerFit) -> float:
    """Return the fit's std, at least the sensor's zero error; the prior std if the zero is off."""
    std, prior = (float(np.sqrt(cov[3, 3])) for cov in (power.cov, power.prior_cov))
    standing = power.standing
    if standing is None:
        return std
    if not standing.is_avionics_measurable:
        return prior
    zero_w = PowerPriors().current_offset_std_a * standing.voltage_v
    return max(std, zero_w * prior / float(np.hypot(zero_w, prior)))


def _avionics_measurement_advice(power: PowerFit) -> str:
    standing = power.standing
    if standing is not None and not standing.is_avionics_measurable:
        return "another current sensor: with the motors off this one reads negative"
    return (
        "keep it disarmed and logging for 20 s before take-off (PX4 SDLOG_MODE 1, ArduPilot"
        " LOG_DISARMED 1)"
    )


def _vertical_drag_quantities(power: PowerFit) -> list[Quantity]:
    """Return the drag of the downward flow, if the start airframe defines it."""
    own = slice(len(POWER_KEYS), None)
    stds, priors = np.sqrt(np.diag(power.cov)), np.sqrt(np.diag(power.prior_cov))
    fast = "fly fast sides, empty (companion calibrate-plan --fast)"
    return [
        Quantity(
            "drag from above",
            "N/(m/s)^2",
            float(value),
            float(std),
            float(prior),
            0.25,
            False,
            fast,
        )
        for value, std, prior in zip(power.values[own], stds[own], priors[own], strict=True)
    ]


def _usable_energy_quantities(battery: BatteryFit, prior_airframe: Airframe) -> list[Quantity]:
    """Return usable energy at the lightest draw, and its loss per further watt."""
    pack, usable = prior_airframe.battery, battery.usable
    level, level_std = pack.usable_frac, pack.usable_std_frac
    loss, loss_std = pack.usable_loss_per_w, pack.usable_loss_per_w
    if usable is not None:
        level, level_std = usable.frac, usable.std_frac
        loss, loss_std = usable.loss_per_w, usable.loss_std_per_w
    hover = "hover from full to 10 %, low over soft ground (companion calibrate-plan --discharge)"
    prior = pack.usable_std_frac if usable is None else _UNMEASURED_USABLE_STD_FRAC
    return [
        Quantity("usable energy", "of the label", level, level_std, prior, 0.05, False, hover),
        Quantity(
            "usable energy lost",
            "per W",
            loss,
            loss_std,
            pack.usable_loss_per_w,
            1.0,
            False,
            "two such hovers, empty and with the heaviest parcel",
        ),
    ]


def _drag_quantity(
    name: str,
    unit: str,
    derivative_by_drag_parameters: Floats,
    fit: DragFit,
    std_limit_frac: float,
    needed: bool,
    identifying_flight_text: str,
) -> Quantity:
    value = float(derivative_by_drag_parameters @ fit.values)
    std = float(np.sqrt(derivative_by_drag_parameters @ fit.cov @ derivative_by_drag_parameters))
    prior = float(
        np.sqrt(derivative_by_drag_parameters @ fit.prior_cov @ derivative_by_drag_parameters)
    )
    # The widened posterior may exceed the prior, which is still valid.
    return Quantity(
        name, unit, value, min(std, prior), prior, std_limit_frac, needed, identifying_flight_text
    )


def _level_flight_power_quantity(
    name: str,
    fitted: Airframe,
    power: PowerFit,
    drag: DragFit,
    payload_kg: float,
    speed_mps: float,
    std_limit_frac: float,
    identifying_flight_text: str,
) -> Quantity:
    value, row = level_power_and_derivatives_w(
        fitted, power.values, drag.values, payload_kg, speed_mps
    )
    std = float(np.sqrt(row @ power.cov @ row))
    prior = float(np.sqrt(row @ power.prior_cov @ row))
    return Quantity(name, "W", value, std, prior, std_limit_frac, True, identifying_flight_text)


def level_power_and_derivatives_w(
    airframe: Airframe,
    power_parameters: Floats,
    drag_parameters: Floats,
    payload_kg: float,
    speed_mps: float,
    density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
) -> tuple[float, Floats]:
    """Return power in level flight and its derivatives by POWER_KEYS."""

    def power_at_parameters_w(values: Floats) -> float:
        candidate = with_drag_and_power_parameters(airframe, drag_parameters, values)
        mass_kg = candidate.flying_mass_kg(payload_kg)
        return float(multirotor_power_w(candidate, mass_kg, speed_mps, 0.0, density_kgpm3))

    value = power_at_parameters_w(power_parameters)
    slopes = np.zeros(len(power_parameters))
    for i in range(len(power_parameters)):
        step = -_RELATIVE_STEP * max(
            abs(power_parameters[i]), 0.01
        )  # negative: efficiency may be at its upper bound
        if power_parameters[i] + step < MIN_VALUES[i]:
            step = -step
        moved = power_parameters.copy()
        moved[i] += step
        slopes[i] = (power_at_parameters_w(moved) - value) / step
    return value, slopes
