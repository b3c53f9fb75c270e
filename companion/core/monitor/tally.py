"""Accumulation of one flight's evidence for the monitor."""

import math
from dataclasses import asdict, dataclass

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.monitor.flight_evidence import FlightEvidence, LogRatio
from companion.core.monitor.promises import DRAW_STD
from companion.core.vehicle.airframe import BatteryPack
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook

LEAST_MODELLED_WH = 2.0
"""Least modelled energy for a comparison: 1.5 minutes of a small multirotor."""

MAX_CURRENT_AGE_S = 1.0
"""Maximum age of a current: an older one was followed by a lost one."""

GAP_S = 5.0
"""Longest gap without a current. After a longer one the drawn energy is unknown: no pack result."""

MIN_DISCHARGE_FRAC = 0.15
"""Smallest fall of the charge that exceeds the voltage's errors."""

DISCHARGE_STD_FRAC = 0.03
"""Std of the fall of charge: 10 mV per cell where the curve is flat. Charge from resting voltages
of an M100's packs has this scatter between flights."""

RELAXATION_FRAC, RELAXATION_S = 0.56, 12.0
"""The voltage of a pack just unloaded is low by this share of its resistance times the current of
the last seconds. [est] from voltages after landings of an M100 whose pack stayed in for the next
flight (Rodrigues et al., 2021)."""

RELAXATION_STD_FRAC = 0.3
"""[est] Relative std of the expected rise of the voltage."""

UNLOADED_FRAC = 0.1
"""Share of the flight's maximum current below which motors are stopped or idle."""

SMOOTHED_S = 3.0
"""Time constant of the voltage after landing: longer than its noise, shorter than its rise."""

CHECK_INTERVAL_S = 60.0
"""Lead time of the wind forecast, and interval of the checks."""

WIND_AVERAGING_S = 10.0
"""Averaging time of the estimator's wind, approximately."""

ELLIPSE_CHI2 = 5.991
"""95 % quantile of chi-square with two degrees of freedom."""


@dataclass(slots=True)
class _FlightSums:
    """State for a checkpoint."""

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
    """Sums of one flight. `flight_evidence` returns the result at its end."""

    def __init__(self, battery: BatteryPack, health_frac: float) -> None:
        self._battery, self._health_frac = battery, health_frac
        self._sums = _FlightSums()
        self._due_s: float | None = None
        self._expected = np.zeros(2)
        self._precision = np.zeros((2, 2))

    def add_power(
        self, dt_s: float, measured_w: float, modelled_w: float, current_age_s: float
    ) -> None:
        """Add measured and modelled power of the same `dt_s` of steady flight."""
        if current_age_s <= MAX_CURRENT_AGE_S and measured_w > 0.0 and modelled_w > 0.0:
            self._sums.measured_wh += measured_w * dt_s / 3600.0
            self._sums.modelled_wh += modelled_w * dt_s / 3600.0

    def add_battery_sample(
        self,
        t_s: float,
        voltage_v: float | None,
        current_a: float | None,
        *,
        disarmed_on_ground: bool,
        on_ground: bool,
    ) -> None:
        """Add the pack's voltage and current at an instant. `disarmed_on_ground`: disarmed on the
        ground;
        `on_ground`: also with idle motors.
        """
        sums = self._sums
        sums.flown = sums.flown or not disarmed_on_ground
        if voltage_v is None or current_a is None or not math.isfinite(voltage_v * current_a):
            return
        dt_s = 0.0 if sums.heard_s is None else t_s - sums.heard_s
        sums.heard_s = t_s
        if sums.flown:
            self._add_drawn_energy(dt_s, voltage_v, current_a)
        if disarmed_on_ground or (on_ground and current_a <= UNLOADED_FRAC * sums.most_a):
            self._update_rest_voltage(dt_s, voltage_v, current_a)

    def _add_drawn_energy(self, dt_s: float, voltage_v: float, current_a: float) -> None:
        sums = self._sums
        sums.blind = sums.blind or not 0.0 <= dt_s <= GAP_S
        dt_s = max(dt_s, 0.0)
        sums.drawn_wh += voltage_v * current_a * dt_s / 3600.0
        sums.lost_wh += current_a**2 * self._battery.resistance_ohm * dt_s / 3600.0
        sums.lately_a += -math.expm1(-dt_s / RELAXATION_S) * (current_a - sums.lately_a)
        sums.most_a = max(sums.most_a, sums.lately_a)

    def _update_rest_voltage(self, dt_s: float, voltage_v: float, current_a: float) -> None:
        """Update the resting voltage: mean before the flight, smoothed latest value after it."""
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

    def check_due_wind_forecast(self, wind_estimate: WindBelief, wind_outlook: WindOutlook) -> None:
        """Check the forecast that is due against the estimated wind in flight; make the next."""
        if self._due_s is None or not wind_estimate.valid:
            if wind_estimate.valid:
                self._store_next_wind_forecast(wind_estimate, wind_outlook)
            return
        if wind_estimate.t_s < self._due_s:
            return
        if wind_estimate.t_s < self._due_s + GAP_S:
            off = wind_estimate.mean_to_ne_mps - self._expected
            self._sums.checks += 1
            self._sums.misses += bool(off @ self._precision @ off > ELLIPSE_CHI2)
        self._store_next_wind_forecast(wind_estimate, wind_outlook)

    def _store_next_wind_forecast(
        self, wind_estimate: WindBelief, wind_outlook: WindOutlook
    ) -> None:
        forecast = wind_outlook.forecast(
            wind_estimate, np.array([CHECK_INTERVAL_S]), WIND_AVERAGING_S
        )
        self._due_s = wind_estimate.t_s + CHECK_INTERVAL_S
        self._expected = forecast.mean_to_ne_mps[0]
        self._precision = np.linalg.inv(forecast.total_cov_m2ps2)

    def flight_evidence(self) -> FlightEvidence:
        """Return the result of the flight."""
        sums = self._sums
        draw = None
        if sums.modelled_wh >= LEAST_MODELLED_WH and sums.measured_wh > 0.0:
            draw = LogRatio(math.log(sums.measured_wh / sums.modelled_wh), DRAW_STD)
        return FlightEvidence(draw, self._capacity_log_ratio(), sums.misses, sums.checks)

    def _capacity_log_ratio(self) -> LogRatio | None:
        """Return the fall of charge, as energy of a nominal pack, over energy drawn and lost."""
        sums, battery = self._sums, self._battery
        if sums.blind or sums.before == 0 or sums.after == 0 or sums.drawn_wh <= 0.0:
            return None
        full = battery.charge_frac_from_resting_voltage(sums.before_v)
        left = battery.charge_frac_from_resting_voltage(sums.after_v)
        std_v = RELAXATION_STD_FRAC * sums.still_v
        high = battery.charge_frac_from_resting_voltage(sums.after_v + std_v)
        low = battery.charge_frac_from_resting_voltage(sums.after_v - std_v)
        if full - left < MIN_DISCHARGE_FRAC:
            return None
        nominal_wh = self._health_frac * _energy_between_charges_wh(battery, left, full)
        ratio = nominal_wh / (sums.drawn_wh + sums.lost_wh)
        discharge_std = math.hypot(DISCHARGE_STD_FRAC, 0.5 * (high - low))
        return LogRatio(math.log(ratio), discharge_std / (full - left))

    def snapshot(self) -> dict[str, object]:
        """Return the state for a checkpoint, without the pending forecast."""
        return asdict(self._sums)

    def restore(self, checkpoint_sums: dict[str, object]) -> None:
        """Restore a checkpoint. Raises LeewayError for an invalid one."""
        try:
            sums = msgspec.convert(checkpoint_sums, _FlightSums)
        except msgspec.ValidationError as error:
            raise LeewayError(f"checkpoint: tally: {error}") from error
        if not all(math.isfinite(value or 0.0) for value in asdict(sums).values()):
            raise LeewayError("checkpoint: tally: expected finite numbers")
        self._sums = sums


def _energy_between_charges_wh(battery: BatteryPack, low_frac: float, high_frac: float) -> float:
    """Return the energy of a new pack between two charges, from its resting voltages."""
    between = _mean_rest_cell_v(battery, np.array([low_frac, high_frac]))
    whole = _mean_rest_cell_v(battery, np.array([0.0, 1.0]))
    return battery.nominal_wh * (high_frac - low_frac) * between / whole


def _mean_rest_cell_v(battery: BatteryPack, charge_limits_frac: Floats) -> float:
    """Return the mean resting voltage of a cell between two charges; exact for a table."""
    inside = [
        c for c in battery.ocv_charge_frac if charge_limits_frac[0] < c < charge_limits_frac[1]
    ]
    charge = np.array([charge_limits_frac[0], *inside, charge_limits_frac[1]])
    volts = np.interp(charge, battery.ocv_charge_frac, battery.ocv_cell_v)
    return float(np.trapezoid(volts, charge) / (charge_limits_frac[1] - charge_limits_frac[0]))
