"""An airframe from its own flights: fits, what they identify, and what they predict unseen.

What a fit identifies is told by what it knows afterwards against what was believed before, in
quantities that a pilot understands (drag at two speeds, power in hover and in cruise): single
numbers of the model may trade against one another without harm. A quantity that stayed near its
prior, or above its stated limit, is not identified, and the flight that would is named.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.core.calibration.battery import BatteryFit, fit_battery
from companion.core.calibration.drag import DragFit, DragPriors, fit_drag, see_wind
from companion.core.calibration.drag_doubts import drag_doubts
from companion.core.calibration.power import (
    VERTICAL_KEY,
    PowerFit,
    air_speeds,
    fit_power,
    power_values,
    predicted_w,
    with_values,
)
from companion.core.calibration.quantities import Quantity, quantities_of
from companion.core.calibration.records import BLOCK_S, Blocks
from companion.core.calibration.standing import StandingPower
from companion.core.calibration.trim import TRIM_KEYS, trim_quantities
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import max_airspeed_mps

_PIECE_BLOCKS = 60  # of the holdout's energy: two minutes, a leg home
_LEAST_MODEL_STD_FRAC = 0.03
"""Residual of the model against the M100's published power over speed: 3.1 % rms
(docs/results/calibration.md)."""
_FASTEST_PERCENTILE = 98.0
_REACH_FRAC = 0.95
_LEAST_BLADE_DRAG = 0.005
"""Half of the least section drag that small rotors' blades have (0.01 to 0.03 at Reynolds numbers
of some 1e5; Leishman 2006, 7.9): less is drag that the fit has booked elsewhere."""


@dataclass(frozen=True, slots=True)
class HeldOutFlight:
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
    holdouts: tuple[HeldOutFlight, ...]
    notes: tuple[str, ...]

    @property
    def missing(self) -> tuple[Quantity, ...]:
        """What had to be identified and is not."""
        return tuple(q for q in self.quantities if q.needed and not q.identified)


def calibrate(
    flights: list[Blocks],
    start: Airframe,
    told: Callable[[str], None] = lambda doing: None,
    *,
    leave_out: bool = True,
    priors: DragPriors | None = None,
    ground: Sequence[StandingPower] = (),
) -> Calibration:
    """Fit an airframe to flights; `start` is what is believed before, `told` hears of progress.
    `priors` of the drag where the usual ones are not meant; `ground` are tests on the ground.

    `leave_out`: fit again without each flight, to say how well it is predicted unseen. Without it
    the start's `power_rotor.model_std_frac` stays. The start's `power_flown` does not: tracks tell
    it (`measured_energy.identified_phases`).
    """
    start = msgspec.structs.replace(start, power_flown=None)  # it belongs to the start's own power
    told("drag and wind")
    drag = fit_drag(flights, start, priors)
    dragged = with_values(start, drag.values, power_values(start))
    told("power")
    power = fit_power(flights, list(drag.winds), dragged, ground=ground)
    told("battery")
    battery = fit_battery(flights, start.battery)
    quantities = quantities_of(flights, start, drag, power, battery)
    quantities += trim_quantities(flights, start, drag)
    holdouts = tuple(_leave_out(flights, start, told, priors)) if leave_out else ()
    airframe, notes = _assembled(flights, start, drag, power, battery, quantities, holdouts)
    notes = (*notes, *_extrapolated(flights, drag, airframe), *_bladeless(airframe, start.name))
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
        " largest tilt; what would tell it: fast sides (companion calibrate-plan --fast), empty, or"
        " stronger wind"
    ]


def _bladeless(airframe: Airframe, start_name: str) -> list[str]:
    """Blades without drag: the sign of a vehicle whose top drags more than its front."""
    if airframe.power_rotor.blade_drag_coefficient >= _LEAST_BLADE_DRAG:
        return []
    if airframe.drag.vertical_quadratic_n_per_mps2 is not None:
        return []
    return [
        f"blade drag came out at {airframe.power_rotor.blade_drag_coefficient:.3f}, and blades have"
        f" 0.01 at least: power in fast flight is too low then. State drag.{VERTICAL_KEY} in"
        f" {start_name} (about 0.7 of the plan area of body, arms and packs in m^2) and fit again"
    ]


def predict(blocks: Blocks, airframe: Airframe) -> HeldOutFlight:
    """A flight's energy by an airframe: its track and tilt are used, its power is compared."""
    wind = see_wind(blocks, airframe)
    flown = blocks.pick(blocks.airborne)
    expected = predicted_w(airframe, blocks, wind)
    whole = len(expected) // _PIECE_BLOCKS or 1
    errors = []
    for piece in np.array_split(np.arange(len(expected)), whole):
        errors.append(float(expected[piece].sum() / flown.power_w[piece].sum() - 1.0))
    return HeldOutFlight(
        blocks.name,
        float(flown.power_w.sum()) * BLOCK_S / 3600.0,
        float(expected.sum()) * BLOCK_S / 3600.0,
        wind.mean_mps,
        float(flown.payload_kg.max()),
        tuple(errors),
    )


def _leave_out(
    flights: list[Blocks],
    start: Airframe,
    told: Callable[[str], None],
    priors: DragPriors | None,
) -> list[HeldOutFlight]:
    """Each flight predicted from the others; of a single one, its last third from the rest."""
    if len(flights) == 1:
        told("holdout: the last third")
        whole = np.flatnonzero(flights[0].airborne)
        split = flights[0].t_s[whole[2 * len(whole) // 3]]
        early = flights[0].pick(flights[0].t_s < split)
        late = flights[0].pick(flights[0].t_s >= split)
        return [predict(late, _fitted([early], start, priors))]
    found = []
    for number, blocks in enumerate(flights):
        told(f"holdout: {blocks.name}")
        others = flights[:number] + flights[number + 1 :]
        found.append(predict(blocks, _fitted(others, start, priors)))
    return found


def _fitted(flights: list[Blocks], start: Airframe, priors: DragPriors | None) -> Airframe:
    drag = fit_drag(flights, start, priors)
    dragged = with_values(start, drag.values, power_values(start))
    power = fit_power(flights, list(drag.winds), dragged)
    return with_values(start, drag.values, power.values)


def _assembled(
    flights: list[Blocks],
    start: Airframe,
    drag: DragFit,
    power: PowerFit,
    battery: BatteryFit,
    quantities: tuple[Quantity, ...],
    holdouts: tuple[HeldOutFlight, ...],
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
    model_std = start.power_rotor.model_std_frac
    if len(pieces):
        model_std = max(float(np.sqrt(np.mean(pieces**2))), _LEAST_MODEL_STD_FRAC)
    fitted = replace(
        fitted,
        drag=replace(fitted.drag, **drag_doubts(flights, drag), **_trims(quantities)),
        power_rotor=replace(fitted.power_rotor, model_std_frac=min(model_std, 0.5)),
    )
    pack = start.battery
    if identified["pack's resistance"]:
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


def _trims(quantities: tuple[Quantity, ...]) -> dict[str, float]:
    """Both mean trims by their keys, where they are identified; a trim may not pass its range."""
    found = {q.name: q for q in quantities if q.name in TRIM_KEYS and q.identified}
    return {TRIM_KEYS[name]: float(np.clip(q.value, -5.0, 5.0)) for name, q in found.items()}
