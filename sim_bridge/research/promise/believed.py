"""The planner's vehicle model: an airframe file, calibrated as an operator would do it.

The shipped parameters hold at the airframe's own cruise speed. `promise` picks the airspeed that
gives the requested wind over airspeed. So the power model is fitted to a calibration flight at that
airspeed: cruise and hover, loaded and empty, in a steady wind.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace
from scipy.optimize import least_squares

from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

_FITTED = 4


@dataclass(frozen=True, slots=True)
class MeasuredPower:
    """Mean electrical power in steady flight."""

    payload_kg: float
    airspeed_mps: float
    power_w: float


def calibrated(airframe: Airframe, measured: Sequence[MeasuredPower]) -> Airframe:
    """Airframe with drag, parcel drag, induced factor and drive efficiency fitted to `measured`.

    Nonlinear least squares on log power, with weak regularisation towards the given airframe.
    """

    def changed(x: Floats) -> Airframe:
        drag, rotor = airframe.drag, airframe.power_rotor
        return replace(
            airframe,
            drag=replace(
                drag,
                quadratic_forward_n_per_mps2=drag.quadratic_forward_n_per_mps2 * float(x[0]),
                parcel_quadratic_n_per_mps2=max(
                    drag.parcel_quadratic_n_per_mps2 + 0.02 * float(x[1] - 1.0), 0.0
                ),
            ),
            power_rotor=replace(
                rotor,
                induced_factor=rotor.induced_factor * float(x[2]),
                drive_efficiency=min(rotor.drive_efficiency * float(x[3]), 1.0),
            ),
        )

    def errors(x: Floats) -> Floats:
        tried = changed(x)
        got = [
            float(multirotor_power_w(tried, tried.mass_kg(m.payload_kg), m.airspeed_mps))
            for m in measured
        ]
        wanted = np.array([m.power_w for m in measured])
        return np.concatenate([np.log(np.array(got) / wanted), 0.01 * (x - 1.0)])

    found = least_squares(errors, np.ones(_FITTED), bounds=(0.6, 1.7))
    return changed(found.x)
