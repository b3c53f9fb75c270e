"""The pack as a source of power: open-circuit voltage, internal resistance and cut-off voltage.

A pack of resistance R gives at most `P = V_cut (V_oc - V_cut) / R` above its cut-off voltage V_cut.
So its usable energy ends at the charge where P falls below the power that the flight needs.

Resistance follows an Arrhenius law of temperature, relative to that of the airframe file at 20
degrees C, and rises towards an empty pack. `ResistanceEstimator` identifies it in flight.
"""

import math
from dataclasses import asdict, dataclass

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import BatteryPack

FILE_TEMPERATURE_C = 20.0
"""Temperature of the resistance in an airframe file."""

_KELVIN = 273.15
_LOW_CHARGE_FRAC, _LOW_CHARGE_GAIN = 0.2, 0.6
"""[est] Below a fifth of charge resistance rises linearly, to 1.6 times at empty."""

PEAK_FRAC = 1.25
"""[est] Peak of 1 s, after which a pack may cut off, over the modelled mean power of a leg. One
simulated M100 flight in Dryden turbulence: 1.32 in 5 m/s, 1.29 and 1.39 against 13 m/s, 1.9 while
a front rises. 1.25 is less: with 1.3 a warm pack decides otherwise, with 1.2 a cold one is lost.
"""

_CHARGES: Floats = np.linspace(0.0, 1.0, 101)
_PRIOR_STD_LOG = 0.20  # [est] resistance of one pack at the temperature of the file
_UNKNOWN_TEMPERATURE_STD_LOG = 0.45  # [est] a pack 10 degrees colder than configured
_LAW_STD_FRAC = 0.3  # [est] error of the temperature law, share of its logarithm
_BLOCK_S = 5.0
_MEMORY_S = 20.0  # [est] correlation time of the errors of voltage, curve and current
_LEAST_CURRENT_C = 1.0  # multiples of the capacity in Ah: the least current that causes a sag
_LEAST_STD_LOG = 0.05
_CURVE_STD_FRAC = 0.2  # [est] error of a difference along the open-circuit curve
_UNSETTLED_FRAC, _UNSETTLED_STD_FRAC, _SETTLING_S = 0.2, 0.12, 30.0
"""Share of the resistance that acts only after this time under load (polarisation), and its std.
[fit] 0.12 in recorded M100 flights; 0.38 in Chen and Rincon-Mora 2006."""

_NO_SAG_FRAC = 0.15
"""A sag below this share of the expected one is that of a constant voltage (simulators)."""


@dataclass(frozen=True, slots=True)
class PackPower:
    """Power of a pack in its present state, over its charge.

    `wh_per_charge` is the energy of the whole charge, `energy_wh` the ledger's remaining energy at
    `charge_frac`. `std_log` is the standard deviation of the logarithm of the resistance.
    """

    battery: BatteryPack
    resistance_ohm: float
    std_log: float
    charge_frac: float
    energy_wh: float
    wh_per_charge: float

    def max_power_w(self, charge_frac: float | None = None, sigmas: float = 0.0) -> float:
        """Return the maximum power at a charge (default: now), infinite without resistance.

        `sigmas`: standard deviations by which resistance is above its estimate.
        """
        charge = self.charge_frac if charge_frac is None else charge_frac
        pack = self.battery
        ohm = self.resistance_ohm * math.exp(sigmas * self.std_log) * float(_rise(charge))
        if ohm <= 0.0:
            return math.inf
        cutoff_v = pack.cells * pack.cutoff_cell_v
        open_v = pack.cells * pack.resting_cell_voltage_v(charge)
        return cutoff_v * max(open_v - cutoff_v, 0.0) / ohm

    @property
    def sustained_power_w(self) -> float:
        """Mean power that the pack can give now with its peaks."""
        return self.max_power_w() / PEAK_FRAC

    def power_shortage_or_empty(self, hover_power_w: float) -> str:
        """Return why it cannot supply a hover, even one sigma better; `""` if it can."""
        most_w = self.max_power_w(sigmas=-1.0)
        if most_w >= hover_power_w:
            return ""
        return f"the battery gives at most {most_w:.0f} W now, hover needs {hover_power_w:.0f} W"

    def unusable_energy_wh(self, mean_power_w: Floats, deviates: Floats) -> Floats:
        """Return the energy (Wh, of the ledger) below which the pack cannot give these powers.

        Shapes broadcast. `deviates`: standard-normal numbers that select the resistance. Negative
        where the ledger counts less energy than the pack holds above that charge.
        """
        pack = self.battery
        cutoff_v = pack.cells * pack.cutoff_cell_v
        ohm = self.resistance_ohm * np.exp(self.std_log * deviates)
        power_ohm = PEAK_FRAC * mean_power_w * ohm
        open_v = pack.cells * np.interp(_CHARGES, pack.ocv_charge_frac, pack.ocv_cell_v)
        limit_power_ohm = cutoff_v * np.maximum(open_v - cutoff_v, 0.0) / _rise(_CHARGES)
        charge = np.interp(power_ohm, limit_power_ohm, _CHARGES)
        # Beyond a full pack the need still rises, so that probabilities stay smooth.
        charge += np.maximum(power_ohm / limit_power_ohm[-1] - 1.0, 0.0)
        return self.energy_wh - (self.charge_frac - charge) * self.wh_per_charge


def _rise(charge_frac: Floats | float) -> Floats | float:
    """Return the resistance at this charge over that of a charged pack."""
    missing = np.maximum(1.0 - np.asarray(charge_frac) / _LOW_CHARGE_FRAC, 0.0)
    return 1.0 + _LOW_CHARGE_GAIN * missing


def resistance_ratio(battery: BatteryPack, temperature_c: float) -> float:
    """Return the resistance at this temperature over that at 20 degrees C."""
    inverse_k = 1.0 / (temperature_c + _KELVIN) - 1.0 / (FILE_TEMPERATURE_C + _KELVIN)
    return math.exp(battery.resistance_activation_k * inverse_k)


@dataclass(frozen=True, slots=True)
class LoadedVoltage:
    """One sample under load. `open_v` is the modelled open-circuit voltage of the pack, derived
    from its resting voltage; `drop_v` the part of it that comes from the curve.
    """

    t_s: float
    voltage_v: float
    current_a: float
    current_std_frac: float
    open_v: float
    drop_v: float


@dataclass(slots=True)
class _ResistanceState:
    """State of the checkpoint: estimate, and the present block of samples."""

    log_ratio: float = 0.0
    variance: float = _UNKNOWN_TEMPERATURE_STD_LOG**2
    temperature_c: float | None = None
    has_measured: bool = False
    loaded_since_s: float | None = None
    block_since_s: float | None = None
    sag_vs: float = 0.0
    charge_as: float = 0.0
    last_s: float | None = None


class ResistanceEstimator:
    """Recursive estimate of a pack's resistance: log of its ratio to that of the airframe file.

    Before a measurement it is the prior by temperature, with a wider standard deviation where the
    autopilot reports no temperature. Blocks of 5 s under load measure it by Ohm's law; errors are
    correlated over 30 s. A voltage that does not sag is no measurement.
    """

    def __init__(self, battery: BatteryPack, configured_temperature_c: float) -> None:
        self._battery = battery
        self._state = _ResistanceState()
        self._set_prior(configured_temperature_c, _UNKNOWN_TEMPERATURE_STD_LOG)

    def update_temperature(self, temperature_c: float) -> None:
        """Set the prior of this temperature until the resistance is measured."""
        if not self._state.has_measured and temperature_c != self._state.temperature_c:
            self._state.temperature_c = temperature_c
            self._set_prior(temperature_c, _PRIOR_STD_LOG)

    def _set_prior(self, temperature_c: float, std_log: float) -> None:
        law_log = math.log(resistance_ratio(self._battery, temperature_c))
        std_log = math.hypot(std_log, _LAW_STD_FRAC * law_log)
        # A warm pack is taken as one of 20 degrees C.
        self._state.log_ratio, self._state.variance = max(law_log, 0.0), std_log**2

    def update_from_sample(self, sample: LoadedVoltage) -> None:
        """Process one sample in flight."""
        state, pack = self._state, self._battery
        dt_s = 0.0 if state.last_s is None else min(max(sample.t_s - state.last_s, 0.0), 1.0)
        state.last_s = sample.t_s
        capacity_ah = pack.nominal_wh / (pack.cells * float(np.mean(pack.ocv_cell_v)))
        if sample.current_a < _LEAST_CURRENT_C * capacity_ah or pack.resistance_ohm <= 0.0:
            state.loaded_since_s = state.block_since_s = None
            return
        if state.loaded_since_s is None:
            state.loaded_since_s = sample.t_s
        if state.block_since_s is None:
            state.block_since_s, state.sag_vs, state.charge_as = sample.t_s, 0.0, 0.0
        state.sag_vs += (sample.open_v - sample.voltage_v) * dt_s
        state.charge_as += sample.current_a * dt_s
        if sample.t_s - state.block_since_s >= _BLOCK_S and state.charge_as > 0.0:
            self._update_from_block(sample, sample.t_s - state.loaded_since_s)
            state.block_since_s = None

    def _update_from_block(self, sample: LoadedVoltage, loaded_s: float) -> None:
        state, pack = self._state, self._battery
        expected_ohm = pack.resistance_ohm * math.exp(state.log_ratio)
        unsettled = math.exp(-loaded_s / _SETTLING_S)
        ohm = state.sag_vs / state.charge_as / (1.0 - _UNSETTLED_FRAC * unsettled)
        if ohm < _NO_SAG_FRAC * expected_ohm:
            return
        std_v = math.hypot(pack.resting_voltage_std_v, _CURVE_STD_FRAC * sample.drop_v)
        mean_a = state.charge_as / _BLOCK_S
        std_log = math.hypot(
            std_v / (mean_a * ohm), sample.current_std_frac, _UNSETTLED_STD_FRAC * unsettled
        )
        noise = std_log**2 * _MEMORY_S / _BLOCK_S
        gain = state.variance / (state.variance + noise)
        state.log_ratio += gain * (math.log(ohm / pack.resistance_ohm) - state.log_ratio)
        state.variance = max(state.variance * (1.0 - gain), _LEAST_STD_LOG**2)
        state.has_measured = True

    def resistance_ohm_and_std_log(self) -> tuple[float, float]:
        """Return the resistance of the charged pack (ohm) and the std of its logarithm."""
        state = self._state
        return self._battery.resistance_ohm * math.exp(state.log_ratio), math.sqrt(state.variance)

    def snapshot(self) -> dict[str, object]:
        """Return the state for a checkpoint."""
        return asdict(self._state)

    def restore(self, snapshot: dict[str, object]) -> None:
        """Restore a checkpoint. Raises LeewayError for an invalid one."""
        try:
            state = msgspec.convert(snapshot, _ResistanceState)
        except msgspec.ValidationError as error:
            raise LeewayError(f"checkpoint: {error}") from error
        if not (math.isfinite(state.log_ratio) and 0.0 < state.variance < math.inf):
            raise LeewayError("checkpoint: expected a finite resistance with its variance")
        self._state = state
