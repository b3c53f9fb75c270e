"""Counts in flight what the monitor is told at its end."""

import math
from dataclasses import asdict, dataclass

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.monitor.figures import FlightFigures, LogRatio
from companion.core.monitor.promises import DRAW_STD
from companion.core.vehicle.airframe import BatteryPack
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook

LEAST_MODELLED_WH = 2.0
"""A shorter flight compares too little: a minute and a half of a small multirotor."""

FRESH_S = 1.0
"""A current that is older was followed by one that was lost."""

GAP_S = 5.0
"""Nobody knows what was drawn in a longer silence: then the flight says nothing of its pack."""

LEAST_FALL_FRAC = 0.15
"""A smaller fall of the charge is lost in the voltage's errors."""

FALL_STD_FRAC = 0.03
"""Of the charge, before and after together: 10 mV a cell where the curve is flat. Charge by rested
voltages of an M100's packs scatters by so much from flight to flight."""

RELAXATION_FRAC, RELAXATION_S = 0.56, 12.0
"""A pack just unloaded reads low, by this share of its resistance times the current of the last
seconds. [est] near the voltages after landings of an M100 whose pack stayed in for the next flight
(Rodrigues et al., 2021)."""

RELAXATION_STD_FRAC = 0.3
"""[est] Of what a voltage is still expected to rise."""

UNLOADED_FRAC = 0.1
"""Of the flight's greatest current: motors that stand or idle."""

SMOOTHED_S = 3.0
"""Of the voltage after landing: longer than its noise, shorter than what it still rises for."""

CHECK_EVERY_S = 60.0
"""A forecast of the wind is held against the wind so much later; then the next is made."""

SECONDS_AVERAGED = 10.0
"""The estimator's wind is a mean over about ten seconds."""

ELLIPSE_CHI2 = 5.991
"""95 % of a chi-square with two degrees of freedom."""


@dataclass(slots=True)
class _Sums:
    """What a checkpoint keeps."""

    measured_wh: float = 0.0
    modelled_wh: float = 0.0
    drawn_wh: float = 0.0
    lost_wh: float = 0.0
    lately_a: float = 0.0
    most_a: float = 0.0
    before_v: float = 0.0
    before: int = 0
    after_v: float = 0.0
    after: int = 0
    still_v: float = 0.0
    flown: bool = False
    blind: bool = False
    heard_s: float | None = None
    misses: int = 0
    checks: int = 0


class FlightTally:
    """One flight's sums; `figures` at its end."""

    def __init__(self, battery: BatteryPack, health_frac: float) -> None:
        self._battery, self._health_frac = battery, health_frac
        self._sums = _Sums()
        self._due_s: float | None = None
        self._expected = np.zeros(2)
        self._precision = np.zeros((2, 2))

    def compare(self, dt_s: float, measured_w: float, modelled_w: float, age_s: float) -> None:
        """Power as measured and as modelled for the same `dt_s` of steady flight."""
        if age_s <= FRESH_S and measured_w > 0.0 and modelled_w > 0.0:
            self._sums.measured_wh += measured_w * dt_s / 3600.0
            self._sums.modelled_wh += modelled_w * dt_s / 3600.0

    def battery(
        self,
        t_s: float,
        voltage_v: float | None,
        current_a: float | None,
        *,
        at_rest: bool,
        on_ground: bool,
    ) -> None:
        """The pack at an instant; `at_rest` only while disarmed on the ground, `on_ground` with
        motors that idle, too.
        """
        sums = self._sums
        sums.flown = sums.flown or not at_rest
        if voltage_v is None or current_a is None or not math.isfinite(voltage_v * current_a):
            return
        dt_s = 0.0 if sums.heard_s is None else t_s - sums.heard_s
        sums.heard_s = t_s
        if sums.flown:
            self._draw(dt_s, voltage_v, current_a)
        if at_rest or (on_ground and current_a <= UNLOADED_FRAC * sums.most_a):
            self._rest(dt_s, voltage_v, current_a)

    def _draw(self, dt_s: float, voltage_v: float, current_a: float) -> None:
        sums = self._sums
        sums.blind = sums.blind or not 0.0 <= dt_s <= GAP_S
        dt_s = max(dt_s, 0.0)
        sums.drawn_wh += voltage_v * current_a * dt_s / 3600.0
        sums.lost_wh += current_a**2 * self._battery.resistance_ohm * dt_s / 3600.0
        sums.lately_a += -math.expm1(-dt_s / RELAXATION_S) * (current_a - sums.lately_a)
        sums.most_a = max(sums.most_a, sums.lately_a)

    def _rest(self, dt_s: float, voltage_v: float, current_a: float) -> None:
        """What it rests at: before the flight the mean, after it what came last, smoothed."""
        sums, ohm = self._sums, self._battery.resistance_ohm
        open_v = voltage_v + current_a * ohm
        if not sums.flown:
            sums.before += 1
            sums.before_v += (open_v - sums.before_v) / sums.before
            return
        still_v = RELAXATION_FRAC * ohm * max(sums.lately_a - current_a, 0.0)
        newest = -math.expm1(-dt_s / SMOOTHED_S) if sums.after > 0 else 1.0
        sums.after += 1
        sums.after_v += newest * (open_v + still_v - sums.after_v)
        sums.still_v = still_v

    def wind(self, belief: WindBelief, outlook: WindOutlook) -> None:
        """The wind as believed now, in the air: judge the forecast that is due, make the next."""
        if self._due_s is None or not belief.valid:
            if belief.valid:
                self._forecast(belief, outlook)
            return
        if belief.t_s < self._due_s:
            return
        if belief.t_s < self._due_s + GAP_S:
            off = belief.mean_to_ne_mps - self._expected
            self._sums.checks += 1
            self._sums.misses += bool(off @ self._precision @ off > ELLIPSE_CHI2)
        self._forecast(belief, outlook)

    def _forecast(self, belief: WindBelief, outlook: WindOutlook) -> None:
        ahead = outlook.forecast(belief, np.array([CHECK_EVERY_S]), SECONDS_AVERAGED)
        self._due_s = belief.t_s + CHECK_EVERY_S
        self._expected = ahead.mean_to_ne_mps[0]
        self._precision = np.linalg.inv(ahead.cov_m2ps2)

    def figures(self) -> FlightFigures:
        """What the flight told."""
        sums = self._sums
        draw = None
        if sums.modelled_wh >= LEAST_MODELLED_WH and sums.measured_wh > 0.0:
            draw = LogRatio(math.log(sums.measured_wh / sums.modelled_wh), DRAW_STD)
        return FlightFigures(draw, self._pack(), sums.misses, sums.checks)

    def _pack(self) -> LogRatio | None:
        """Charge fallen, as energy of a pack as stated, over the energy drawn and lost inside."""
        sums, battery = self._sums, self._battery
        if sums.blind or sums.before == 0 or sums.after == 0 or sums.drawn_wh <= 0.0:
            return None
        full = battery.charge_frac_at_rest(sums.before_v)
        left = battery.charge_frac_at_rest(sums.after_v)
        doubt_v = RELAXATION_STD_FRAC * sums.still_v
        high = battery.charge_frac_at_rest(sums.after_v + doubt_v)
        low = battery.charge_frac_at_rest(sums.after_v - doubt_v)
        if full - left < LEAST_FALL_FRAC:
            return None
        stated_wh = self._health_frac * _energy_wh(battery, left, full)
        ratio = stated_wh / (sums.drawn_wh + sums.lost_wh)
        fall_std = math.hypot(FALL_STD_FRAC, 0.5 * (high - low))
        return LogRatio(math.log(ratio), fall_std / (full - left))

    def snapshot(self) -> dict[str, object]:
        """What a checkpoint keeps; a forecast that waits for its minute is not."""
        return asdict(self._sums)

    def restore(self, kept: dict[str, object]) -> None:
        """Go on from a checkpoint; LeewayError when it is not one."""
        try:
            sums = msgspec.convert(kept, _Sums)
        except msgspec.ValidationError as error:
            raise LeewayError(f"checkpoint: tally: {error}") from error
        if not all(math.isfinite(value or 0.0) for value in asdict(sums).values()):
            raise LeewayError("checkpoint: tally: expected finite numbers")
        self._sums = sums


def _energy_wh(battery: BatteryPack, low_frac: float, high_frac: float) -> float:
    """Energy that a new pack holds between two charges, by its resting voltages."""
    between = _mean_cell_v(battery, np.array([low_frac, high_frac]))
    whole = _mean_cell_v(battery, np.array([0.0, 1.0]))
    return battery.nominal_wh * (high_frac - low_frac) * between / whole


def _mean_cell_v(battery: BatteryPack, ends: Floats) -> float:
    """Mean resting voltage of a cell between two charges; exact for a table."""
    inside = [c for c in battery.ocv_charge_frac if ends[0] < c < ends[1]]
    charge = np.array([ends[0], *inside, ends[1]])
    volts = np.interp(charge, battery.ocv_charge_frac, battery.ocv_cell_v)
    return float(np.trapezoid(volts, charge) / (ends[1] - ends[0]))
