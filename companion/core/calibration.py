"""An airframe from its own flights: fits, what they identify, and what they predict unseen.

What a fit identifies is told by what it knows afterwards against what was believed before, in
quantities that a pilot understands (drag at two speeds, power in hover and in cruise): single
numbers of the model may trade against one another without harm. A quantity that stayed near its
prior, or above its stated limit, is not identified, and the flight that would is named.
"""

from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.core.airframe import Airframe
from companion.core.calibration_battery import BatteryFit, fit_battery
from companion.core.calibration_drag import DragFit, fit_drag, see_wind
from companion.core.calibration_flight import square_speeds_mps
from companion.core.calibration_power import (
    PowerFit,
    air_speeds,
    fit_power,
    power_values,
    predicted_w,
    with_values,
)
from companion.core.calibration_records import BLOCK_S, Blocks
from companion.core.power import max_airspeed_mps, multirotor_power_w

FloatArray = NDArray[np.float64]

_POSTERIOR_OVER_PRIOR = 0.6
_PIECE_BLOCKS = 60  # of the holdout's energy: two minutes, a leg home
_LEAST_MODEL_STD_FRAC = 0.03
"""What the model leaves of the M100's published power over speed (3.1 % rms; docs/calibrate.md)."""
_LEAST_GAIN_STD_FRAC = 0.05
"""Drag goes with the air's density: 5 % are 15 degrees, between the days of logs and of use."""
_RESISTANCE_LIMIT_FRAC = 0.25
_UNMEASURED_USABLE_STD_FRAC = 0.1  # [est] of a pack that nobody discharged
_FASTEST_PERCENTILE = 98.0
_REACH_FRAC = 0.95
_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class Quantity:
    """Something the fit should know: its value, std now and before, and the limit on the std.

    `needed`: refused where it is not identified; otherwise kept from the start airframe, and said.
    """

    name: str
    unit: str
    value: float
    std: float
    prior_std: float
    limit_frac: float
    needed: bool
    flight: str

    @property
    def identified(self) -> bool:
        """Known well enough, and by these flights rather than by belief."""
        well = self.std <= self.limit_frac * abs(self.value)
        return well and self.std <= _POSTERIOR_OVER_PRIOR * self.prior_std


@dataclass(frozen=True, slots=True)
class Holdout:
    """One flight predicted by an airframe that was fitted without it (energy in the air)."""

    name: str
    measured_wh: float
    predicted_wh: float
    wind_mps: float
    payload_kg: float
    piece_errors: tuple[float, ...]

    @property
    def error_frac(self) -> float:
        """Predicted over measured, less 1."""
        return self.predicted_wh / self.measured_wh - 1.0


@dataclass(frozen=True, slots=True)
class Calibration:
    """`airframe` is fitted in all that is identified; `holdouts` leave each log out in turn."""

    airframe: Airframe
    drag: DragFit
    power: PowerFit
    battery: BatteryFit
    quantities: tuple[Quantity, ...]
    holdouts: tuple[Holdout, ...]
    notes: tuple[str, ...]

    @property
    def missing(self) -> tuple[Quantity, ...]:
        """What had to be identified and is not."""
        return tuple(q for q in self.quantities if q.needed and not q.identified)


def calibrate(
    flights: list[Blocks],
    start: Airframe,
    told: Callable[[str], None] = lambda doing: None,
) -> Calibration:
    """Fit an airframe to flights; `start` is what is believed before, `told` hears of progress."""
    told("drag and wind")
    drag = fit_drag(flights, start)
    dragged = with_values(start, drag.values, power_values(start))
    told("power")
    power = fit_power(flights, list(drag.winds), dragged)
    told("battery")
    battery = fit_battery(flights, start.battery)
    quantities = _quantities(flights, start, drag, power, battery)
    holdouts = tuple(_leave_out(flights, start, told))
    airframe, notes = _assembled(start, drag, power, battery, quantities, holdouts)
    notes = (*notes, *_extrapolated(flights, drag, airframe))
    return Calibration(airframe, drag, power, battery, quantities, holdouts, notes)


def _extrapolated(flights: list[Blocks], drag: DragFit, airframe: Airframe) -> list[str]:
    """Where the tilt limit's airspeed lies well beyond what was flown."""
    met = [air_speeds(b, wind)[0] for b, wind in zip(flights, drag.winds, strict=True)]
    fastest = float(np.percentile(np.concatenate(met), _FASTEST_PERCENTILE))
    limit = max_airspeed_mps(airframe, airframe.mass.empty_kg)
    if fastest > _REACH_FRAC * limit:
        return []
    return [
        f"drag above {fastest:.0f} m/s of airspeed is extrapolated, up to {limit:.1f} m/s at the"
        " largest tilt; what would tell it: a faster square, or one in stronger wind"
    ]


def predict(blocks: Blocks, airframe: Airframe) -> Holdout:
    """A flight's energy by an airframe: its track and tilt are used, its power is compared."""
    wind = see_wind(blocks, airframe)
    flown = blocks.pick(blocks.airborne)
    expected = predicted_w(airframe, blocks, wind)
    whole = len(expected) // _PIECE_BLOCKS or 1
    errors = []
    for piece in np.array_split(np.arange(len(expected)), whole):
        errors.append(float(expected[piece].sum() / flown.power_w[piece].sum() - 1.0))
    return Holdout(
        blocks.name,
        float(flown.power_w.sum()) * BLOCK_S / 3600.0,
        float(expected.sum()) * BLOCK_S / 3600.0,
        wind.mean_mps,
        float(flown.payload_kg.max()),
        tuple(errors),
    )


def _leave_out(
    flights: list[Blocks], start: Airframe, told: Callable[[str], None]
) -> list[Holdout]:
    """Each flight predicted from the others; of a single one, its last third from the rest."""
    if len(flights) == 1:
        told("holdout: the last third")
        whole = np.flatnonzero(flights[0].airborne)
        split = flights[0].t_s[whole[2 * len(whole) // 3]]
        early = flights[0].pick(flights[0].t_s < split)
        late = flights[0].pick(flights[0].t_s >= split)
        return [predict(late, _fitted([early], start))]
    found = []
    for number, blocks in enumerate(flights):
        told(f"holdout: {blocks.name}")
        others = flights[:number] + flights[number + 1 :]
        found.append(predict(blocks, _fitted(others, start)))
    return found


def _fitted(flights: list[Blocks], start: Airframe) -> Airframe:
    drag = fit_drag(flights, start)
    dragged = with_values(start, drag.values, power_values(start))
    power = fit_power(flights, list(drag.winds), dragged)
    return with_values(start, drag.values, power.values)


def _quantities(
    flights: list[Blocks], start: Airframe, drag: DragFit, power: PowerFit, battery: BatteryFit
) -> tuple[Quantity, ...]:
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
            float(np.sqrt(power.cov[3, 3])),
            float(np.sqrt(power.prior_cov[3, 3])),
            1.0,
            False,
            "leave it armed off, but logging, for 20 s before take-off (PX4 SDLOG_MODE 1,"
            " ArduPilot LOG_DISARMED 1)",
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
    name: str, unit: str, row: FloatArray, fit: DragFit, limit: float, needed: bool, flight: str
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
    power: FloatArray,
    drag: FloatArray,
    payload_kg: float,
    speed_mps: float,
    density_kgpm3: float = 1.225,
) -> tuple[float, FloatArray]:
    """Power in level flight and its derivatives by POWER_KEYS."""

    def at(values: FloatArray) -> float:
        tried = with_values(airframe, drag, values)
        mass_kg = tried.mass_kg(payload_kg)
        return float(multirotor_power_w(tried, mass_kg, speed_mps, 0.0, density_kgpm3))

    value = at(power)
    slopes = np.zeros(len(power))
    for i in range(len(power)):
        step = -_STEP * max(abs(power[i]), 0.01)  # down: efficiency may stand at its greatest
        if power[i] + step < 0.0:
            step = -step
        moved = power.copy()
        moved[i] += step
        slopes[i] = (at(moved) - value) / step
    return value, slopes


def _assembled(
    start: Airframe,
    drag: DragFit,
    power: PowerFit,
    battery: BatteryFit,
    quantities: tuple[Quantity, ...],
    holdouts: tuple[Holdout, ...],
) -> tuple[Airframe, tuple[str, ...]]:
    """The start airframe with everything in it that was fitted; and what was kept."""
    replace = msgspec.structs.replace
    notes = [
        f"{q.name}: not identified, as good as in {start.name}; what would: {q.flight}"
        for q in quantities
        if not q.needed and not q.identified
    ]
    identified = {q.name: q.identified for q in quantities}
    fitted = with_values(start, drag.values, power.values)
    pieces = np.array([e for h in holdouts for e in h.piece_errors])
    model_std = max(float(np.sqrt(np.mean(pieces**2))), _LEAST_MODEL_STD_FRAC)
    fitted = replace(
        fitted,
        drag=replace(fitted.drag, gain_std_frac=_gain_std(start, drag)),
        power_rotor=replace(fitted.power_rotor, model_std_frac=min(model_std, 0.5)),
    )
    pack = start.battery
    if identified["pack's resistance"]:
        pack = replace(pack, resistance_ohm=battery.resistance_ohm)
    if (usable := battery.usable) is not None:
        pack = replace(
            pack,
            usable_frac=min(usable.frac, 1.0),
            usable_at_w=usable.at_w,
            usable_loss_per_w=usable.loss_per_w,
            usable_std_frac=usable.std_frac,
        )
    return replace(fitted, battery=pack), tuple(notes)


def _gain_std(start: Airframe, drag: DragFit) -> float:
    """How wrong forward drag at cruise is believed to be, relative."""
    speed = start.speeds.cruise_airspeed_mps
    row = np.array([speed, 0.0, speed**2, 0.0, 0.0])
    std = float(np.sqrt(row @ drag.cov @ row)) / float(row @ drag.values)
    return float(np.clip(std, _LEAST_GAIN_STD_FRAC, 1.0))
