"""What a calibration should know, in quantities that a pilot understands, and how well it does.

Drag at two speeds, power in hover, cruise and at the fastest, the pack: single numbers of the
models may trade against one another without harm. Each names the flight that would identify it.
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.calibration.battery import BatteryFit
from companion.core.calibration.drag import DragFit
from companion.core.calibration.flight import square_speeds_mps
from companion.core.calibration.power import (
    LEAST_VALUES,
    POWER_KEYS,
    PowerFit,
    PowerPriors,
    with_values,
)
from companion.core.calibration.records import Blocks
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

_POSTERIOR_OVER_PRIOR = 0.6
_RESISTANCE_LIMIT_FRAC = 0.25
_UNMEASURED_USABLE_STD_FRAC = 0.1  # [est] of a pack that nobody discharged
_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class Quantity:
    """Something the fit should know: its value, std now and before, and the limit on the std.

    `needed`: refused where it is not identified; otherwise kept from the start airframe, and said.
    `limit_std`: the limit in the unit itself, of a quantity whose value may be zero.
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
    def identified(self) -> bool:
        """Known well enough, and by these flights rather than by belief."""
        limit = self.limit_frac * abs(self.value) if self.limit_std is None else self.limit_std
        well = self.std <= limit
        return well and self.std <= _POSTERIOR_OVER_PRIOR * self.prior_std


def quantities_of(
    flights: list[Blocks], start: Airframe, drag: DragFit, power: PowerFit, battery: BatteryFit
) -> tuple[Quantity, ...]:
    """All that the fits tell, in the order in which it is shown."""
    slow, _, fast = square_speeds_mps(start)
    cruise = start.speeds.cruise_airspeed_mps
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
                _linear(f"drag {name} at {speed:g} m/s", "N", row, drag, limit, needed, flight)
            )
    row = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
    parcel = "fly the square once with a parcel aboard and once without"
    found.append(_linear("parcel's drag", "N/(m/s)^2", row, drag, 0.5, False, parcel))
    found += _from_above(power)
    fitted = with_values(start, drag.values, power.values)
    heavy = max(float(b.payload_kg.max()) for b in flights) or start.mass.max_payload_kg
    hover = "hover for 30 s"
    loads = "fly the square with two loads, one near the largest"
    for name, payload, speed, limit, flight in (
        ("power in hover, empty", 0.0, 0.0, 0.05, hover),
        (f"power at {cruise:g} m/s, empty", 0.0, cruise, 0.05, speeds),
        (f"power in hover with {heavy:g} kg", heavy, 0.0, 0.05, loads),
    ):
        found.append(_power_quantity(name, fitted, power, drag, payload, speed, limit, flight))
    found.append(
        Quantity(
            "avionics",
            "W",
            float(power.values[3]),
            avionics_std_w(power),
            float(np.sqrt(power.prior_cov[3, 3])),
            1.0,
            False,
            _to_tell_avionics(power),
        )
    )
    found.append(
        Quantity(
            "pack's resistance",
            "ohm",
            battery.resistance_ohm,
            battery.resistance_std_ohm,
            0.5 * start.battery.resistance_ohm,
            _RESISTANCE_LIMIT_FRAC,
            False,
            "log the pack at rest before take-off, and fly the square with a climb",
        )
    )
    found += _usable_quantities(battery, start)
    return tuple(found)


def avionics_std_w(power: PowerFit) -> float:
    """Of the fit, and no less than one sensor's zero leaves; as before where that zero is wrong."""
    std, prior = (float(np.sqrt(cov[3, 3])) for cov in (power.cov, power.prior_cov))
    standing = power.standing
    if standing is None:
        return std
    if not standing.tells_avionics:
        return prior
    zero_w = PowerPriors().current_offset_std_a * standing.voltage_v
    return max(std, zero_w * prior / float(np.hypot(zero_w, prior)))


def _to_tell_avionics(power: PowerFit) -> str:
    standing = power.standing
    if standing is not None and not standing.tells_avionics:
        return (
            "another meter at the pack: with the motors off the current sensor reads less than"
            " nothing"
        )
    return (
        "let it stand disarmed, but logging, for 20 s before take-off (PX4 SDLOG_MODE 1, ArduPilot"
        " LOG_DISARMED 1)"
    )


def _from_above(power: PowerFit) -> list[Quantity]:
    """Drag of the flow down through the rotors, where the start airframe states it."""
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


def _usable_quantities(battery: BatteryFit, start: Airframe) -> list[Quantity]:
    """Usable energy at the lightest draw, and what each watt more takes of it."""
    pack, usable = start.battery, battery.usable
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


def _linear(
    name: str, unit: str, row: Floats, fit: DragFit, limit: float, needed: bool, flight: str
) -> Quantity:
    value = float(row @ fit.values)
    std = float(np.sqrt(row @ fit.cov @ row))
    prior = float(np.sqrt(row @ fit.prior_cov @ row))
    # Widened for what the fit leaves out, it may pass the prior, which holds all the same.
    return Quantity(name, unit, value, min(std, prior), prior, limit, needed, flight)


def _power_quantity(
    name: str,
    fitted: Airframe,
    power: PowerFit,
    drag: DragFit,
    payload_kg: float,
    speed_mps: float,
    limit: float,
    flight: str,
) -> Quantity:
    value, row = power_and_slope(fitted, power.values, drag.values, payload_kg, speed_mps)
    std = float(np.sqrt(row @ power.cov @ row))
    prior = float(np.sqrt(row @ power.prior_cov @ row))
    return Quantity(name, "W", value, std, prior, limit, True, flight)


def power_and_slope(
    airframe: Airframe,
    power: Floats,
    drag: Floats,
    payload_kg: float,
    speed_mps: float,
    density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
) -> tuple[float, Floats]:
    """Power in level flight and its derivatives by POWER_KEYS."""

    def at(values: Floats) -> float:
        tried = with_values(airframe, drag, values)
        mass_kg = tried.mass_kg(payload_kg)
        return float(multirotor_power_w(tried, mass_kg, speed_mps, 0.0, density_kgpm3))

    value = at(power)
    slopes = np.zeros(len(power))
    for i in range(len(power)):
        step = -_STEP * max(abs(power[i]), 0.01)  # down: efficiency may stand at its greatest
        if power[i] + step < LEAST_VALUES[i]:
            step = -step
        moved = power.copy()
        moved[i] += step
        slopes[i] = (at(moved) - value) / step
    return value, slopes
