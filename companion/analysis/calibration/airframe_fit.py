"""Fit of an airframe to its flights: identified quantities and held-out prediction errors.

Identification compares posterior and prior standard deviation of quantities that a pilot
understands (drag at two speeds, power in hover and in cruise): single model parameters may be
correlated without harm. A quantity close to its prior or above its limit is not identified; the
flight that would identify it is named.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.analysis.calibration.battery import BatteryFit, fit_battery
from companion.analysis.calibration.drag import DragFit, DragPriors, estimate_wind, fit_drag
from companion.analysis.calibration.drag_uncertainty import drag_uncertainty_fields
from companion.analysis.calibration.ground_power import StandingPower
from companion.analysis.calibration.power import (
    VERTICAL_KEY,
    PowerFit,
    airspeed_and_lateral_part_mps,
    fit_power,
    power_parameter_vector,
    predicted_airborne_power_w,
    with_drag_and_power_parameters,
)
from companion.analysis.calibration.quantities import Quantity, build_quantities
from companion.analysis.calibration.records import BLOCK_S, Blocks
from companion.analysis.calibration.trim import TRIM_KEYS, trim_quantities
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import level_airspeed_at_max_tilt_mps

_SEGMENT_BLOCKS = 60  # segment of held-out energy: two minutes, one return leg
_MIN_MODEL_STD_FRAC = 0.03
"""Residual of the model against the M100's published power over speed: 3.1 % rms
(docs/results/real-flights.md)."""
_MAX_AIRSPEED_PERCENTILE = 98.0
_MIN_SPEED_COVERAGE_FRAC = 0.95
_MIN_BLADE_DRAG = 0.005
"""Half of the least section drag that small rotors' blades have (0.01 to 0.03 at Reynolds numbers
of some 1e5; Leishman 2006, 7.9): below it the fit attributes blade drag to other terms."""


@dataclass(frozen=True, slots=True)
class ValidationFlight:
    """Predicted and measured airborne energy of a flight that the fit did not use."""

    name: str
    measured_wh: float
    predicted_wh: float
    wind_mps: float
    payload_kg: float
    piece_errors: tuple[float, ...]

    @property
    def relative_energy_error(self) -> float:
        """Predicted over measured, less 1."""
        return self.predicted_wh / self.measured_wh - 1.0


@dataclass(frozen=True, slots=True)
class Calibration:
    """`airframe` has the identified parameters; `holdouts` are by leave-one-log-out."""

    airframe: Airframe
    drag: DragFit
    power: PowerFit
    battery: BatteryFit
    quantities: tuple[Quantity, ...]
    holdouts: tuple[ValidationFlight, ...]
    notes: tuple[str, ...]

    @property
    def unidentified_required_quantities(self) -> tuple[Quantity, ...]:
        """Required quantities that are not identified."""
        return tuple(q for q in self.quantities if q.needed and not q.is_identifiable)


def fit_airframe_to_flights(
    flights: list[Blocks],
    prior_airframe: Airframe,
    report_progress: Callable[[str], None] = lambda step_name: None,
    *,
    measure_holdout_error: bool = True,
    priors: DragPriors | None = None,
    standing_power_tests: Sequence[StandingPower] = (),
) -> Calibration:
    """Fit an airframe to flights, from `prior_airframe`. A callback receives progress texts.
    `priors` replace the default drag priors; `standing_power_tests` are tests on the ground.

    `measure_holdout_error`: repeat the fit without each flight, to measure the held-out prediction
    error. Without it the start's `power_rotor.model_std_frac` is kept. The start's `power_flown` is
    dropped; tracks identify it (`measured_energy.identified_phases`).
    """
    prior_airframe = msgspec.structs.replace(
        prior_airframe, power_flown=None
    )  # valid with its own model only
    report_progress("drag and wind")
    drag = fit_drag(flights, prior_airframe, priors)
    with_fitted_drag = with_drag_and_power_parameters(
        prior_airframe, drag.values, power_parameter_vector(prior_airframe)
    )
    report_progress("power")
    power = fit_power(
        flights, list(drag.winds), with_fitted_drag, standing_power_tests=standing_power_tests
    )
    report_progress("battery")
    battery = fit_battery(flights, prior_airframe.battery)
    quantities = build_quantities(flights, prior_airframe, drag, power, battery)
    quantities += trim_quantities(flights, prior_airframe, drag)
    holdouts = (
        tuple(_cross_validate(flights, prior_airframe, report_progress, priors))
        if measure_holdout_error
        else ()
    )
    airframe, notes = _assemble_airframe(
        flights, prior_airframe, drag, power, battery, quantities, holdouts
    )
    notes = (
        *notes,
        *_extrapolation_notes(flights, drag, airframe),
        *_blade_drag_notes(airframe, prior_airframe.name),
    )
    return Calibration(airframe, drag, power, battery, quantities, holdouts, notes)


def _extrapolation_notes(flights: list[Blocks], drag: DragFit, airframe: Airframe) -> list[str]:
    """Return a note if the airspeed at the tilt limit is well above the flown airspeeds."""
    airspeeds_mps = [
        airspeed_and_lateral_part_mps(b, wind)[0]
        for b, wind in zip(flights, drag.winds, strict=True)
    ]
    fastest = float(np.percentile(np.concatenate(airspeeds_mps), _MAX_AIRSPEED_PERCENTILE))
    limit = level_airspeed_at_max_tilt_mps(airframe, airframe.mass.empty_kg)
    if fastest > _MIN_SPEED_COVERAGE_FRAC * limit:
        return []
    return [
        f"drag above {fastest:.0f} m/s of airspeed is extrapolated, up to {limit:.1f} m/s at the"
        " largest tilt; to identify it: fast sides (companion calibrate-plan --fast), empty, or"
        " stronger wind"
    ]


def _blade_drag_notes(airframe: Airframe, start_name: str) -> list[str]:
    """Return a note on missing blade drag, typical if the top area exceeds the front area."""
    if airframe.power_rotor.blade_drag_coefficient >= _MIN_BLADE_DRAG:
        return []
    if airframe.drag.vertical_quadratic_n_per_mps2 is not None:
        return []
    return [
        f"blade drag is {airframe.power_rotor.blade_drag_coefficient:.3f}, expected"
        f" 0.01 or more: power at speed is too low. Set drag.{VERTICAL_KEY} in"
        f" {start_name} (about 0.7 of the plan area of body, arms and packs in m^2), then refit"
    ]


def predict_flight_energy(blocks: Blocks, airframe: Airframe) -> ValidationFlight:
    """Predict a flight's energy from its track and tilt; compare it with the measured power."""
    wind = estimate_wind(blocks, airframe)
    flown = blocks.select(blocks.airborne)
    expected = predicted_airborne_power_w(airframe, blocks, wind)
    segment_count = len(expected) // _SEGMENT_BLOCKS or 1
    errors = []
    for segment in np.array_split(np.arange(len(expected)), segment_count):
        errors.append(float(expected[segment].sum() / flown.power_w[segment].sum() - 1.0))
    return ValidationFlight(
        blocks.name,
        float(flown.power_w.sum()) * BLOCK_S / 3600.0,
        float(expected.sum()) * BLOCK_S / 3600.0,
        wind.mean_mps,
        float(flown.payload_kg.max()),
        tuple(errors),
    )


def _cross_validate(
    flights: list[Blocks],
    prior_airframe: Airframe,
    report_progress: Callable[[str], None],
    priors: DragPriors | None,
) -> list[ValidationFlight]:
    """Predict each flight from the others; of a single flight, the last third from the rest."""
    if len(flights) == 1:
        report_progress("holdout: the last third")
        airborne_indices = np.flatnonzero(flights[0].airborne)
        split = flights[0].t_s[airborne_indices[2 * len(airborne_indices) // 3]]
        early = flights[0].select(flights[0].t_s < split)
        late = flights[0].select(flights[0].t_s >= split)
        return [predict_flight_energy(late, _fit_airframe([early], prior_airframe, priors))]
    found = []
    for number, blocks in enumerate(flights):
        report_progress(f"holdout: {blocks.name}")
        others = flights[:number] + flights[number + 1 :]
        found.append(predict_flight_energy(blocks, _fit_airframe(others, prior_airframe, priors)))
    return found


def _fit_airframe(
    flights: list[Blocks], prior_airframe: Airframe, priors: DragPriors | None
) -> Airframe:
    drag = fit_drag(flights, prior_airframe, priors)
    with_fitted_drag = with_drag_and_power_parameters(
        prior_airframe, drag.values, power_parameter_vector(prior_airframe)
    )
    power = fit_power(flights, list(drag.winds), with_fitted_drag)
    return with_drag_and_power_parameters(prior_airframe, drag.values, power.values)


def _assemble_airframe(
    flights: list[Blocks],
    prior_airframe: Airframe,
    drag: DragFit,
    power: PowerFit,
    battery: BatteryFit,
    quantities: tuple[Quantity, ...],
    holdouts: tuple[ValidationFlight, ...],
) -> tuple[Airframe, tuple[str, ...]]:
    """Return the start airframe with the fitted values, and notes on kept values."""
    replace = msgspec.structs.replace
    notes = [
        f"{q.name}: not identified, uses {prior_airframe.name}; to identify it: {q.flight}"
        for q in quantities
        if not q.needed and not q.is_identifiable
    ]
    identifiable_by_name = {q.name: q.is_identifiable for q in quantities}
    fitted = with_drag_and_power_parameters(prior_airframe, drag.values, power.values)
    segment_errors = np.array([e for h in holdouts for e in h.piece_errors])
    model_std = prior_airframe.power_rotor.model_std_frac
    if len(segment_errors):
        model_std = max(float(np.sqrt(np.mean(segment_errors**2))), _MIN_MODEL_STD_FRAC)
    fitted = replace(
        fitted,
        drag=replace(
            fitted.drag, **drag_uncertainty_fields(flights, drag), **_identifiable_trims(quantities)
        ),
        power_rotor=replace(fitted.power_rotor, model_std_frac=min(model_std, 0.5)),
    )
    pack = prior_airframe.battery
    if identifiable_by_name["pack's resistance"]:
        pack = replace(pack, resistance_ohm=max(battery.resistance_ohm, 0.0))
    if (usable := battery.usable) is not None:
        pack = replace(
            pack,
            usable_frac=min(usable.frac, 1.0),
            usable_at_w=usable.at_w,
            usable_loss_per_w=usable.loss_per_w,
            usable_std_frac=usable.std_frac,
        )
    return replace(fitted, battery=pack), tuple(notes)


def _identifiable_trims(quantities: tuple[Quantity, ...]) -> dict[str, float]:
    """Return the identified mean trims by key, clipped to their valid range."""
    found = {q.name: q for q in quantities if q.name in TRIM_KEYS and q.is_identifiable}
    return {TRIM_KEYS[name]: float(np.clip(q.value, -5.0, 5.0)) for name, q in found.items()}
