"""Remaining usable energy from autopilot measurements (safety rule 4). It never rises in flight.

It starts from the resting voltage. Each source (current counter, percentage, power model) gives the
consumption since then, and the largest one applies. A fall faster than the vehicle can draw only
widens the standard deviation until the fall is physically possible. Energies are in Wh, as on
battery labels.
"""

import math
from dataclasses import asdict, dataclass, field, fields, replace

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe, BatteryPack
from companion.core.vehicle.battery_gauge import Gauge
from companion.core.vehicle.pack_model import PackPower
from companion.core.vehicle.power import level_airspeed_at_max_tilt_mps, multirotor_power_w

SNAPSHOT_FORMAT = "energy-ledger/2"

_GAP_S = 5.0  # longer gaps are filled with the larger of the last and the modelled power
_GAP_DRAW_ERROR_FRAC, _GAP_SIGMAS = 0.3, 3.0  # a gap beyond these is a step of the clock
_COUNTER_STD_FRAC = 0.03  # relative error of consumption by current sensors and counters
_MODEL_STD_FRAC = 0.10  # relative error of consumption by the power model in unknown wind
_UNDERCOUNT_FRAC = 0.6  # a counter below this share of the model is rejected
_COUNTER_CHECK_WH = 2.0  # modelled consumption from which counters are compared with the model
_DISAGREE_FRAC = 0.10  # difference between sources for a warning, share of usable energy
_LOADED_CELL_STD_V = 0.035  # std of a resting voltage derived from a loaded one (sag, diffusion)
_LOADED_SMOOTHING_S = 30.0
_FAULT_DRAW_FACTOR = 2.0  # maximum over modelled power: measured with ice or a failing motor
_UNCONFIRMED_FRAC = 0.03  # maximum std from one unconfirmed reading, share of usable energy
_PERCENT_STEP_FRAC = 0.02  # occasional step of sources in whole per cents
_UNIFORM_STD_FRAC = 1.0 / math.sqrt(12.0)  # std of a uniform charge from empty to full
_CEILING_SIGMAS = 2.5
_CEILING_SAG_FRAC = 1.75  # assumed sag over that of the resistance: cold, age, diffusion
_UNKNOWN_CHARGE_FRAC, _UNKNOWN_CHARGE_STD_FRAC = 0.8, 0.15


@dataclass(frozen=True, slots=True)
class BatteryObservation:
    """Battery telemetry at one instant; None is unknown (never -1 or 0).

    `at_rest` is True only while disarmed on the ground (voltage is then the resting voltage).
    `modelled_power_w` is the current draw by the power model. `remaining_is_timer` marks a
    percentage that counts time (PX4 SIH): it is then ignored.
    """

    t_s: float
    at_rest: bool
    voltage_v: float | None = None
    current_a: float | None = None
    consumed_mah: float | None = None
    consumed_wh: float | None = None
    remaining_frac: float | None = None
    remaining_is_timer: bool = False
    temperature_c: float | None = None
    modelled_power_w: float | None = None
    source: str = "battery"
    """Message and pack of the counters and the percentage."""
    is_current_low: bool = False
    """Whether the current sensor was found to read low: the power model counts, too."""


@dataclass(frozen=True, slots=True)
class EnergyBelief:
    """Remaining usable energy (Wh, to the cut-off, reserve included) and its std.

    `usable_full_wh` is the usable energy of a full pack (the reserve is a share of it). `source`
    names the source that applies; `warnings` are texts, empty without a problem. `used_wh` is the
    consumption since the start by the source that counts most. `pack` limits the power.
    """

    t_s: float
    mean_wh: float
    std_wh: float
    usable_full_wh: float
    source: str
    warnings: tuple[str, ...] = ()
    used_wh: float = 0.0
    start: "StartOfCount | None" = None
    pack: PackPower | None = None


@dataclass(frozen=True, slots=True)
class StartOfCount:
    """Energy, charge and resting voltage of the pack (None: not measured) at the start."""

    energy_wh: float
    charge_frac: float
    rest_voltage_v: float | None


@dataclass(slots=True)
class _LedgerState:
    """State of the checkpoint. Consumed Wh by source since the start; None: never received."""

    t_s: float | None = None
    start_wh: float | None = None
    start_std_wh: float = 0.0
    start_source: str = ""
    started: bool = False
    usable_full_wh: float = 0.0
    rest_voltage_v: float | None = None
    rest_samples: int = 0
    loaded_cell_v: float | None = None
    current_wh: float | None = None
    modelled_wh: float = 0.0
    unmeasured_wh: float = 0.0
    last_power_w: float | None = None
    last_voltage_v: float | None = None
    gauges: dict[str, Gauge] = field(default_factory=dict)
    left_wh: float | None = None
    left_std_wh: float = 0.0
    slack_wh: float = 0.0
    source: str = ""
    warnings: list[str] = field(default_factory=list)


_SNAPSHOT_KEYS = tuple(f.name for f in fields(_LedgerState))


class EnergyLedger:
    """Energy count of one vehicle and battery."""

    def __init__(
        self,
        airframe: Airframe,
        expected_draw_w: float,
        density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
        *,
        health_frac: float = 1.0,
        temperature_c: float = 20.0,
        configured_charge_frac: float | None = None,
    ) -> None:
        self._airframe = airframe
        self._battery = airframe.battery
        self._draw_w = expected_draw_w
        self._health_frac = health_frac
        self._temperature_c = temperature_c
        self._configured_charge_frac = configured_charge_frac
        self._is_current_low = False
        self._state = _LedgerState()
        self._max_draw_w = max_draw_with_fault_w(airframe, density_kgpm3)
        self._update_usable_full_energy()

    def update_expected_and_max_draw(self, density_kgpm3: float, expected_draw_w: float) -> None:
        """Set the expected draw in air of this density. Call it on the ground."""
        self._draw_w = expected_draw_w
        self._max_draw_w = max_draw_with_fault_w(self._airframe, density_kgpm3)
        self._update_usable_full_energy()

    def update_from_observation(self, observation: BatteryObservation) -> None:
        """Process one observation (any rate). Unless the time advances, only update counters."""
        state = self._state
        previous_s = state.t_s
        if not math.isfinite(observation.t_s):
            raise ValueError(f"observation.t_s = {observation.t_s}, expected a finite time")
        reading = _replace_invalid_values_by_none(observation)
        self._is_current_low = observation.is_current_low
        is_started = state.started or not reading.at_rest
        self._update_gauge_of_source(reading, is_started)
        # Several sources at one instant are one sample of the resting voltage.
        if not state.started and reading.t_s != previous_s:
            self._update_start_energy(reading)
            state.started = is_started
        dt_s = 0.0 if previous_s is None else max(reading.t_s - previous_s, 0.0)
        if self._is_gap_impossible(reading, dt_s):
            dt_s = _GAP_S
        if dt_s > 0.0:
            self._integrate_measured_and_modelled_power(reading, dt_s)
        if previous_s is None or reading.t_s > previous_s:
            state.t_s = reading.t_s
        self._update_remaining_energy_estimate(reading, dt_s)

    def energy_belief_or_none(self) -> EnergyBelief | None:
        """Return the remaining energy, or None before the first observation."""
        state = self._state
        if state.left_wh is None or state.t_s is None:
            return None
        return EnergyBelief(
            state.t_s,
            state.left_wh,
            state.left_std_wh,
            state.usable_full_wh,
            state.source,
            tuple(state.warnings),
            max(self._consumed_wh_by_source().values()),
            self._start_of_count(),
        )

    def _start_of_count(self) -> StartOfCount | None:
        state = self._state
        if state.start_wh is None or state.usable_full_wh <= 0.0:
            return None
        empty = charge_frac_at_loaded_cutoff_voltage(self._battery, self._draw_w)
        charge = empty + (1.0 - empty) * state.start_wh / state.usable_full_wh
        return StartOfCount(state.start_wh, charge, state.rest_voltage_v)

    def snapshot(self) -> dict[str, object]:
        """Return the state for a checkpoint (numbers and strings, JSON-safe)."""
        return {"format": SNAPSHOT_FORMAT, **asdict(self._state)}

    def restore(self, snapshot: dict[str, object]) -> None:
        """Restore a checkpoint; energy never rises. Raises LeewayError for an invalid one."""
        values = {key: value for key, value in snapshot.items() if key != "format"}
        if snapshot.get("format") != SNAPSHOT_FORMAT or values.keys() != set(_SNAPSHOT_KEYS):
            raise LeewayError(f"checkpoint: expected an {SNAPSHOT_FORMAT} snapshot")
        try:
            state = msgspec.convert(values, _LedgerState)
        except msgspec.ValidationError as error:
            raise LeewayError(f"checkpoint: {error}") from error
        for key, value in values.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise LeewayError(f"checkpoint: {key} = {value!r}, expected a finite number")
        before = self._state.left_wh
        self._state = state
        after = self._state.left_wh
        if before is not None and (after is None or before < after):
            self._state.left_wh = before

    # -- the start -----------------------------------------------------------------------------

    def _update_usable_full_energy(self) -> None:
        state = self._state
        state.usable_full_wh = self._battery.usable_energy_of_full_pack_wh(
            self._draw_w, self._temperature_c, self._health_frac
        )

    def _update_start_energy(self, reading: BatteryObservation) -> None:
        state = self._state
        if reading.temperature_c is not None:
            self._temperature_c = reading.temperature_c
            self._update_usable_full_energy()
        charge, charge_std, state.start_source = self._update_start_charge_std_and_source(reading)
        usable = state.usable_full_wh
        state.start_wh = usable * self._usable_energy_frac_at_charge(charge)
        spread = self._battery.usable_std_frac * state.start_wh
        state.start_std_wh = math.hypot(spread, charge_std * usable)

    def _update_start_charge_std_and_source(
        self, reading: BatteryObservation
    ) -> tuple[float, float, str]:
        """Return (charge, its standard deviation, source)."""
        state = self._state
        if (
            reading.at_rest
            and self._is_plausible_pack_voltage(reading.voltage_v)
            and reading.voltage_v is not None
        ):
            state.rest_samples += 1
            mean = state.rest_voltage_v or 0.0
            state.rest_voltage_v = mean + (reading.voltage_v - mean) / state.rest_samples
        if state.rest_voltage_v is not None:
            std_v = self._battery.resting_voltage_std_v
            return *self._charge_and_std_from_resting_voltage(
                state.rest_voltage_v, std_v
            ), "resting voltage"
        if (
            self._is_plausible_pack_voltage(reading.voltage_v)
            and reading.voltage_v
            and _is_above_zero(reading.current_a)
        ):
            rest_v = reading.voltage_v + (reading.current_a or 0.0) * self._battery.resistance_ohm
            std_v = _LOADED_CELL_STD_V * self._battery.cells
            return *self._charge_and_std_from_resting_voltage(rest_v, std_v), "loaded voltage"
        if (reported_frac := self._least_reported_charge_frac()) is not None:
            return reported_frac, 0.05, "autopilot's percentage"
        if self._configured_charge_frac is not None:
            return self._configured_charge_frac, 0.05, "charge as stated"
        return _UNKNOWN_CHARGE_FRAC, _UNKNOWN_CHARGE_STD_FRAC, "nothing known of the battery"

    def _charge_and_std_from_resting_voltage(
        self, rest_v: float, std_v: float
    ) -> tuple[float, float]:
        battery = self._battery
        step_v = max(std_v, 1e-3)
        high = battery.charge_frac_from_resting_voltage(rest_v + step_v)
        low = battery.charge_frac_from_resting_voltage(rest_v - step_v)
        return battery.charge_frac_from_resting_voltage(rest_v), 0.5 * (high - low)

    def _usable_energy_frac_at_charge(self, charge_frac: float) -> float:
        """Return the share of the usable energy at this charge: 0 at the loaded cut-off."""
        empty = charge_frac_at_loaded_cutoff_voltage(self._battery, self._draw_w)
        return min(max((charge_frac - empty) / (1.0 - empty), 0.0), 1.0)

    def _is_plausible_pack_voltage(self, voltage_v: float | None) -> bool:
        low_v, high_v = self._battery.plausible_pack_voltage_range_v
        return voltage_v is not None and low_v <= voltage_v <= high_v

    def _is_gap_impossible(self, reading: BatteryObservation, dt_s: float) -> bool:
        """Return whether a flight of this time would have emptied the pack: the clock jumped."""
        state = self._state
        if dt_s <= _GAP_S or reading.at_rest or not state.started or state.left_wh is None:
            return False
        least_wh = (1.0 - _GAP_DRAW_ERROR_FRAC) * self._draw_w * dt_s / 3600.0
        return least_wh > state.left_wh + _GAP_SIGMAS * state.left_std_wh

    # -- counting ------------------------------------------------------------------------------

    def _update_gauge_of_source(self, reading: BatteryObservation, is_started: bool) -> None:
        """Update counters and percentage of the observation's source."""
        state, max_draw_w = self._state, self._max_draw_w
        gauge = state.gauges.setdefault(reading.source, Gauge())
        if reading.consumed_wh is not None:
            gauge.energy.update_from_reading(
                reading.t_s, reading.consumed_wh, 1.0, max_draw_w, is_started
            )
        if reading.consumed_mah is not None:
            unit_wh = self._latest_plausible_voltage_v(reading) / 1000.0
            gauge.charge.update_from_reading(
                reading.t_s, reading.consumed_mah, unit_wh, max_draw_w, is_started
            )
        if reading.remaining_frac is not None and not reading.remaining_is_timer:
            full_wh, reported = state.usable_full_wh, reading.remaining_frac
            if gauge.percentage.update_and_report_replacement_at_start(
                reading.t_s, reported, full_wh, max_draw_w, is_started
            ):
                state.left_wh = None  # nothing was consumed yet, so the earlier estimate was wrong

    def _latest_plausible_voltage_v(self, reading: BatteryObservation) -> float:
        """Return the latest plausible voltage, for converting charge to energy."""
        voltage_v = (
            reading.voltage_v if self._is_plausible_pack_voltage(reading.voltage_v) else None
        )
        voltage_v = voltage_v or self._state.last_voltage_v
        return voltage_v or self._battery.cells * self._battery.ocv_cell_v[-1]

    def _integrate_measured_and_modelled_power(
        self, reading: BatteryObservation, dt_s: float
    ) -> None:
        state = self._state
        power_w = None
        if (
            self._is_plausible_pack_voltage(reading.voltage_v)
            and reading.voltage_v
            and _is_above_zero(reading.current_a)
        ):
            drawn_w = reading.voltage_v * (reading.current_a or 0.0)
            power_w = drawn_w if drawn_w <= self._max_draw_w else None
        modelled_w = reading.modelled_power_w
        flown_w = 0.0 if reading.at_rest else self._draw_w if modelled_w is None else modelled_w
        if dt_s > _GAP_S and state.started:
            accepted_w = power_w if power_w is not None else 0.0
            power_now_w = max(accepted_w, state.last_power_w or 0.0)
            measured_w = max(power_now_w, flown_w) if power_now_w > 0.0 else None
        else:
            measured_w = power_w
        if measured_w is not None and state.started:
            state.current_wh = (state.current_wh or 0.0) + measured_w * dt_s / 3600.0
        elif state.started:
            state.unmeasured_wh += flown_w * dt_s / 3600.0
        if state.started:
            state.modelled_wh += flown_w * dt_s / 3600.0
        state.last_power_w = power_w
        if self._is_plausible_pack_voltage(reading.voltage_v):
            state.last_voltage_v = reading.voltage_v
            self._update_resting_cell_voltage_bound(reading, dt_s)

    def _update_resting_cell_voltage_bound(self, reading: BatteryObservation, dt_s: float) -> None:
        """Update the smoothed upper bound on a cell's resting voltage from its loaded voltage."""
        if reading.voltage_v is None or reading.current_a is None:
            return
        sag_v = _CEILING_SAG_FRAC * reading.current_a * self._battery.resistance_ohm
        cell_v = (reading.voltage_v + sag_v) / self._battery.cells
        before = self._state.loaded_cell_v
        share = 1.0 - math.exp(-dt_s / _LOADED_SMOOTHING_S)
        self._state.loaded_cell_v = cell_v if before is None else before + share * (cell_v - before)

    # -- the estimate --------------------------------------------------------------------------

    def _update_remaining_energy_estimate(self, reading: BatteryObservation, dt_s: float) -> None:
        state = self._state
        start = state.start_wh
        if start is None:
            return
        left, std, source = self._lowest_remaining_std_and_source(start)
        warnings = self._build_warnings(start, reading)
        ceiling = self._max_energy_by_loaded_voltage_wh()
        if state.started and ceiling is not None and ceiling < left:
            left, source = ceiling, "loaded voltage"
            warnings.append(f"voltage under load limits the energy to {ceiling:.0f} Wh")
        left = max(left, 0.0)
        possible = self._update_slack_and_least_remaining_wh(dt_s)
        if state.left_wh is not None:
            state.slack_wh = max(state.slack_wh - (state.left_wh - max(left, possible)), 0.0)
        pending_std_wh = max(0.5 * (possible - left), self._std_of_pending_percentage_wh())
        left = max(left, possible)
        if state.left_wh is None or left <= state.left_wh:
            state.left_wh, state.source = left, source
        widest_wh = _UNIFORM_STD_FRAC * state.usable_full_wh
        state.left_std_wh = min(math.hypot(std, pending_std_wh), widest_wh)
        state.warnings = warnings

    def _update_slack_and_least_remaining_wh(self, dt_s: float) -> float:
        """Return the energy that remains at least, if the vehicle had its maximum draw."""
        state = self._state
        if state.left_wh is None or not state.started:
            return 0.0
        most_wh = self._max_draw_w * dt_s / 3600.0
        whole_wh = _PERCENT_STEP_FRAC * state.usable_full_wh
        state.slack_wh = max(min(state.slack_wh + most_wh, whole_wh), most_wh)
        return max(state.left_wh - state.slack_wh, 0.0)

    def _std_of_pending_percentage_wh(self) -> float:
        """Return the std added by a pending reading of the percentage."""
        pending_frac = max(
            (g.percentage.pending_drop_frac for g in self._state.gauges.values()), default=0.0
        )
        return min(0.5 * pending_frac, _UNCONFIRMED_FRAC) * self._state.usable_full_wh

    def _lowest_remaining_std_and_source(self, start_wh: float) -> tuple[float, float, str]:
        """Return (remaining, standard deviation, source) by the source that leaves least."""
        state = self._state
        used = self._consumed_wh_by_source()
        source = max(used, key=lambda name: used[name])
        frac = _MODEL_STD_FRAC if source == "modelled power" else _COUNTER_STD_FRAC
        std = math.hypot(state.start_std_wh, frac * used[source])
        left, name = start_wh - used[source], f"{state.start_source} less {source}"
        percentage_wh = self._energy_by_least_percentage_wh()
        if percentage_wh is not None and percentage_wh < left:
            left, name = percentage_wh, "autopilot's percentage"
        return left, std, name

    def _energy_by_least_percentage_wh(self) -> float | None:
        least = self._least_reported_charge_frac()
        return None if least is None else least * self._state.usable_full_wh

    def _least_reported_charge_frac(self) -> float | None:
        """Return the lowest percentage of all packs and messages; None without one."""
        reported = [g.percentage.left_frac for g in self._state.gauges.values()]
        return min((frac for frac in reported if frac is not None), default=None)

    def _largest_energy_and_charge_counts_wh(self) -> tuple[float | None, float | None]:
        """Return the largest count of the energy counters and of the charge counters."""
        energy = [g.energy.counted_wh for g in self._state.gauges.values()]
        charge = [g.charge.counted_wh for g in self._state.gauges.values()]
        return (
            max((wh for wh in energy if wh is not None), default=None),
            max((wh for wh in charge if wh is not None), default=None),
        )

    def _consumed_wh_by_source(self) -> dict[str, float]:
        state = self._state
        energy_wh, charge_wh = self._largest_energy_and_charge_counts_wh()
        counted = {
            "voltage x current": state.current_wh,
            "autopilot's energy counter": energy_wh,
            "autopilot's charge counter": charge_wh,
        }
        used = {name: wh for name, wh in counted.items() if wh is not None}
        if state.current_wh is not None:
            used["voltage x current"] = state.current_wh + state.unmeasured_wh
        most = max(used.values(), default=0.0)
        if not used or self._is_below_modelled_consumption(most):
            used["modelled power"] = state.modelled_wh
        return used

    def _is_below_modelled_consumption(self, measured_wh: float) -> bool:
        modelled = self._state.modelled_wh
        counted_frac = 1.0 if self._is_current_low else _UNDERCOUNT_FRAC
        return modelled > _COUNTER_CHECK_WH and measured_wh < counted_frac * modelled

    def _max_energy_by_loaded_voltage_wh(self) -> float | None:
        cell_v = self._state.loaded_cell_v
        if cell_v is None:
            return None
        battery = self._battery
        high_v = (cell_v + _CEILING_SIGMAS * _LOADED_CELL_STD_V) * battery.cells
        return self._state.usable_full_wh * self._usable_energy_frac_at_charge(
            battery.charge_frac_from_resting_voltage(high_v)
        )

    def _build_warnings(self, start_wh: float, reading: BatteryObservation) -> list[str]:
        state = self._state
        warnings: list[str] = []
        if reading.voltage_v is not None and not self._is_plausible_pack_voltage(reading.voltage_v):
            warnings.append(
                f"{reading.voltage_v:.1f} V does not fit {self._battery.cells} cells: not used"
            )
        if state.start_source != "resting voltage":
            warnings.append(f"initial energy from: {state.start_source}")
        if reading.remaining_is_timer:
            warnings.append("the autopilot's percentage counts time, not energy: not used")
        used = self._consumed_wh_by_source()
        if "modelled power" in used and state.modelled_wh > _COUNTER_CHECK_WH:
            reason = (
                "counts less than the power model" if len(used) > 1 else "measures no consumption"
            )
            warnings.append(f"the autopilot {reason}: energy by the power model")
        remaining_wh = {name: start_wh - wh for name, wh in used.items()}
        percentage_wh = self._energy_by_least_percentage_wh()
        if percentage_wh is not None:
            remaining_wh["autopilot's percentage"] = percentage_wh
        low, high = (
            min(remaining_wh, key=lambda n: remaining_wh[n]),
            max(remaining_wh, key=lambda n: remaining_wh[n]),
        )
        if remaining_wh[high] - remaining_wh[low] > _DISAGREE_FRAC * state.usable_full_wh:
            warnings.append(
                f"{low} leaves {max(remaining_wh[low], 0.0):.0f} Wh, {high}"
                f" {remaining_wh[high]:.0f} Wh:"
                " the lowest is used"
            )
        return warnings


def charge_frac_at_loaded_cutoff_voltage(battery: BatteryPack, draw_w: float) -> float:
    """Return the charge at which the loaded voltage equals the cut-off at this draw."""
    loaded_v = battery.cutoff_cell_v * battery.cells
    sag_v = draw_w / loaded_v * battery.resistance_ohm
    return min(battery.charge_frac_from_resting_voltage(loaded_v + sag_v), 0.9)


def max_draw_with_fault_w(airframe: Airframe, density_kgpm3: float) -> float:
    """Return the maximum draw with a fault: loaded, climbing at maximum airspeed."""
    mass_kg = airframe.flying_mass_kg(airframe.mass.max_payload_kg)
    top_mps = level_airspeed_at_max_tilt_mps(airframe, mass_kg, density_kgpm3)
    climb_mps = airframe.speeds.climb_mps
    drawn_w = multirotor_power_w(airframe, mass_kg, top_mps, climb_mps, density_kgpm3)
    return _FAULT_DRAW_FACTOR * float(drawn_w)


def _is_above_zero(value: float | None) -> bool:
    return value is not None and value > 0.0


def _replace_invalid_values_by_none(reading: BatteryObservation) -> BatteryObservation:
    """Replace NaN, infinities and negative values (-1 of MAVLink) by None."""

    def finite_nonnegative_or_none(value: float | None) -> float | None:
        return value if value is not None and math.isfinite(value) and value >= 0.0 else None

    celsius = reading.temperature_c
    is_in_range = celsius is not None and math.isfinite(celsius) and -60.0 <= celsius <= 90.0
    remaining = finite_nonnegative_or_none(reading.remaining_frac)
    return replace(
        reading,
        voltage_v=finite_nonnegative_or_none(reading.voltage_v),
        current_a=finite_nonnegative_or_none(reading.current_a),
        consumed_mah=finite_nonnegative_or_none(reading.consumed_mah),
        consumed_wh=finite_nonnegative_or_none(reading.consumed_wh),
        remaining_frac=min(remaining, 1.0) if remaining is not None else None,
        temperature_c=celsius if is_in_range else None,
        modelled_power_w=finite_nonnegative_or_none(reading.modelled_power_w),
    )
