"""Usable energy left, from what the autopilot measures (safety rule 4): in flight it falls only.

It starts from the resting voltage. Each source (current counter, percentage, power model) tells
what was consumed since; the one that tells most is believed, as far as physics allows: what falls
faster than the vehicle can draw is doubt, a wider standard deviation, until the fall is believable.
Energies are in Wh, as on battery labels.
"""

import math
from dataclasses import asdict, dataclass, field, fields, replace

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe, BatteryPack
from companion.core.vehicle.battery_gauge import Gauge
from companion.core.vehicle.power import max_airspeed_mps, multirotor_power_w

SNAPSHOT_FORMAT = "energy-ledger/2"

_GAP_S = 5.0  # longer silences are filled with the larger of the last and the modelled power
_COUNTER_STD_FRAC = 0.03  # error of current sensors and counters, of what was consumed
_MODEL_STD_FRAC = 0.10  # error of the power model in unknown wind, of what was consumed
_UNDERCOUNT_FRAC = 0.6  # a counter below this share of the model is not believed
_JUDGE_COUNTERS_WH = 2.0  # modelled consumption from which counters are judged
_DISAGREE_FRAC = 0.10  # of the usable energy, between sources, for a warning
_LOADED_CELL_STD_V = 0.035  # of a resting voltage reckoned from a loaded one (sag, diffusion)
_LOADED_SMOOTHING_S = 30.0
_DRAW_TIMES = 2.0  # of the model's greatest power: what a vehicle with ice or a dying motor drew
_UNCONFIRMED_FRAC = 0.03  # of the usable energy: the most that one unconfirmed reading widens by
_WHOLE_FRAC = 0.02  # sources that come in whole per cents fall by so much at once, now and then
_NOTHING_KNOWN_FRAC = 1.0 / math.sqrt(12.0)  # anything from empty to full: no std is wider
_CEILING_SIGMAS = 2.5
_CEILING_SAG_FRAC = 1.75  # sag that is granted, of what the resistance says: cold, age, diffusion
_UNKNOWN_CHARGE_FRAC, _UNKNOWN_CHARGE_STD_FRAC = 0.8, 0.15


@dataclass(frozen=True, slots=True)
class BatteryObservation:
    """What telemetry says about the battery at one instant; None is unknown (never -1 or 0).

    `at_rest` is True only while disarmed on the ground (voltage is then the resting voltage).
    `modelled_power_w` is what the power model says the vehicle draws now.
    `remaining_is_timer` marks a percentage that is known to count time (PX4 SIH): it is then no
    source of energy.
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
    """Which message, of which pack, counters and percentage are from."""


@dataclass(frozen=True, slots=True)
class EnergyBelief:
    """Usable energy left (Wh, to the cut-off, reserve included), and how sure that is.

    `usable_full_wh` is what a full pack would give (the reserve is a share of it). `source` names
    the source that rules; `warnings` are in words, empty when all is well. `used_wh` is what has
    been consumed since the start by the source that counts most.
    """

    t_s: float
    mean_wh: float
    std_wh: float
    usable_full_wh: float
    source: str
    warnings: tuple[str, ...] = ()
    used_wh: float = 0.0


@dataclass(slots=True)
class _Counts:
    """What the checkpoint keeps. Consumed Wh by source since the start; None: never heard."""

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


_KEPT = tuple(f.name for f in fields(_Counts))


class EnergyLedger:
    """Counts; one per vehicle and battery."""

    def __init__(
        self,
        airframe: Airframe,
        expected_draw_w: float,
        density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
        *,
        health_frac: float = 1.0,
        temperature_c: float = 20.0,
        charge_frac_stated: float | None = None,
    ) -> None:
        self._airframe = airframe
        self._battery = airframe.battery
        self._draw_w = expected_draw_w
        self._health_frac = health_frac
        self._temperature_c = temperature_c
        self._stated = charge_frac_stated
        self._counts = _Counts()
        self._most_w = most_power_w(airframe, density_kgpm3)
        self._size()

    def fly_in(self, density_kgpm3: float, expected_draw_w: float) -> None:
        """Expect the draw of this air from now on; for a vehicle that stands."""
        self._draw_w = expected_draw_w
        self._most_w = most_power_w(self._airframe, density_kgpm3)
        self._size()

    def observe(self, observation: BatteryObservation) -> None:
        """Take one observation (any rate). Times that do not advance only refresh the counters."""
        counts = self._counts
        previous_s = counts.t_s
        if not math.isfinite(observation.t_s):
            raise ValueError(f"observation time {observation.t_s}")
        seen = _finite(observation)
        begun = counts.started or not seen.at_rest
        self._hear_gauge(seen, begun)
        # Several sources may tell at one instant: it is one sample of the resting voltage.
        if not counts.started and seen.t_s != previous_s:
            self._take_start(seen)
            counts.started = begun
        dt_s = 0.0 if previous_s is None else max(seen.t_s - previous_s, 0.0)
        if dt_s > 0.0:
            self._integrate(seen, dt_s)
        if previous_s is None or seen.t_s > previous_s:
            counts.t_s = seen.t_s
        self._settle(seen, dt_s)

    def belief(self) -> EnergyBelief | None:
        """Energy left, or None while nothing at all is known."""
        counts = self._counts
        if counts.left_wh is None or counts.t_s is None:
            return None
        return EnergyBelief(
            counts.t_s,
            counts.left_wh,
            counts.left_std_wh,
            counts.usable_full_wh,
            counts.source,
            tuple(counts.warnings),
            max(self._consumed().values()),
        )

    def snapshot(self) -> dict[str, object]:
        """What the checkpoint keeps (plain numbers and strings, JSON-safe)."""
        return {"format": SNAPSHOT_FORMAT, **asdict(self._counts)}

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint without ever rising; LeewayError when it is not one."""
        values = {key: value for key, value in snapshot.items() if key != "format"}
        if snapshot.get("format") != SNAPSHOT_FORMAT or values.keys() != set(_KEPT):
            raise LeewayError(f"checkpoint: expected an {SNAPSHOT_FORMAT} snapshot")
        try:
            counts = msgspec.convert(values, _Counts)
        except msgspec.ValidationError as error:
            raise LeewayError(f"checkpoint: {error}") from error
        for key, value in values.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise LeewayError(f"checkpoint: {key} = {value!r}, expected a finite number")
        before = self._counts.left_wh
        self._counts = counts
        after = self._counts.left_wh
        if before is not None and (after is None or before < after):
            self._counts.left_wh = before

    # -- the start -----------------------------------------------------------------------------

    def _size(self) -> None:
        counts = self._counts
        counts.usable_full_wh = self._battery.usable_wh(
            self._draw_w, self._temperature_c, self._health_frac
        )

    def _take_start(self, seen: BatteryObservation) -> None:
        counts = self._counts
        if seen.temperature_c is not None:
            self._temperature_c = seen.temperature_c
            self._size()
        charge, charge_std, counts.start_source = self._start_charge(seen)
        usable = counts.usable_full_wh
        counts.start_wh = usable * self._above_cutoff(charge)
        spread = self._battery.usable_std_frac * counts.start_wh
        counts.start_std_wh = math.hypot(spread, charge_std * usable)

    def _start_charge(self, seen: BatteryObservation) -> tuple[float, float, str]:
        """(charge, its standard deviation, where from)."""
        counts = self._counts
        if seen.at_rest and self._plausible(seen.voltage_v) and seen.voltage_v is not None:
            counts.rest_samples += 1
            mean = counts.rest_voltage_v or 0.0
            counts.rest_voltage_v = mean + (seen.voltage_v - mean) / counts.rest_samples
        if counts.rest_voltage_v is not None:
            std_v = self._battery.resting_voltage_std_v
            return *self._charge(counts.rest_voltage_v, std_v), "resting voltage"
        if self._plausible(seen.voltage_v) and seen.voltage_v and _positive(seen.current_a):
            rest_v = seen.voltage_v + (seen.current_a or 0.0) * self._battery.resistance_ohm
            std_v = _LOADED_CELL_STD_V * self._battery.cells
            return *self._charge(rest_v, std_v), "loaded voltage"
        if (told_frac := self._least_percentage()) is not None:
            return told_frac, 0.05, "autopilot's percentage"
        if self._stated is not None:
            return self._stated, 0.05, "charge as stated"
        return _UNKNOWN_CHARGE_FRAC, _UNKNOWN_CHARGE_STD_FRAC, "nothing known of the battery"

    def _charge(self, rest_v: float, std_v: float) -> tuple[float, float]:
        battery = self._battery
        step_v = max(std_v, 1e-3)
        high = battery.charge_frac_at_rest(rest_v + step_v)
        low = battery.charge_frac_at_rest(rest_v - step_v)
        return battery.charge_frac_at_rest(rest_v), 0.5 * (high - low)

    def _above_cutoff(self, charge_frac: float) -> float:
        """Share of the usable energy at this charge: none of it at the loaded cut-off."""
        empty = cutoff_charge_frac(self._battery, self._draw_w)
        return min(max((charge_frac - empty) / (1.0 - empty), 0.0), 1.0)

    def _plausible(self, voltage_v: float | None) -> bool:
        low_v, high_v = self._battery.plausible_v
        return voltage_v is not None and low_v <= voltage_v <= high_v

    # -- counting ------------------------------------------------------------------------------

    def _hear_gauge(self, seen: BatteryObservation, begun: bool) -> None:
        """Counters and percentage of one source; of no other."""
        counts, most_w = self._counts, self._most_w
        gauge = counts.gauges.setdefault(seen.source, Gauge())
        if seen.consumed_wh is not None:
            gauge.energy.hear(seen.t_s, seen.consumed_wh, 1.0, most_w, begun)
        if seen.consumed_mah is not None:
            unit_wh = self._voltage_v(seen) / 1000.0
            gauge.charge.hear(seen.t_s, seen.consumed_mah, unit_wh, most_w, begun)
        if seen.remaining_frac is not None and not seen.remaining_is_timer:
            full_wh, told = counts.usable_full_wh, seen.remaining_frac
            if gauge.percentage.hear(seen.t_s, told, full_wh, most_w, begun):
                counts.left_wh = None  # nothing was used yet: what was believed was wrong

    def _voltage_v(self, seen: BatteryObservation) -> float:
        """The voltage to price a charge by: the newest that fits the pack."""
        voltage_v = seen.voltage_v if self._plausible(seen.voltage_v) else None
        voltage_v = voltage_v or self._counts.last_voltage_v
        return voltage_v or self._battery.cells * self._battery.ocv_cell_v[-1]

    def _integrate(self, seen: BatteryObservation, dt_s: float) -> None:
        counts = self._counts
        power_w = None
        if self._plausible(seen.voltage_v) and seen.voltage_v and _positive(seen.current_a):
            drawn_w = seen.voltage_v * (seen.current_a or 0.0)
            power_w = drawn_w if drawn_w <= self._most_w else None
        modelled_w = seen.modelled_power_w
        flown_w = 0.0 if seen.at_rest else self._draw_w if modelled_w is None else modelled_w
        if dt_s > _GAP_S and counts.started:
            believed = power_w if power_w is not None else 0.0
            power_now_w = max(believed, counts.last_power_w or 0.0)
            measured_w = max(power_now_w, flown_w) if power_now_w > 0.0 else None
        else:
            measured_w = power_w
        if measured_w is not None and counts.started:
            counts.current_wh = (counts.current_wh or 0.0) + measured_w * dt_s / 3600.0
        elif counts.started:
            counts.unmeasured_wh += flown_w * dt_s / 3600.0
        if counts.started:
            counts.modelled_wh += flown_w * dt_s / 3600.0
        counts.last_power_w = power_w
        if self._plausible(seen.voltage_v):
            counts.last_voltage_v = seen.voltage_v
            self._smooth_loaded(seen, dt_s)

    def _smooth_loaded(self, seen: BatteryObservation, dt_s: float) -> None:
        """The most that a cell may rest at, reckoned from its loaded voltage, smoothed."""
        if seen.voltage_v is None or seen.current_a is None:
            return
        sag_v = _CEILING_SAG_FRAC * seen.current_a * self._battery.resistance_ohm
        cell_v = (seen.voltage_v + sag_v) / self._battery.cells
        before = self._counts.loaded_cell_v
        share = 1.0 - math.exp(-dt_s / _LOADED_SMOOTHING_S)
        self._counts.loaded_cell_v = (
            cell_v if before is None else before + share * (cell_v - before)
        )

    # -- the belief ----------------------------------------------------------------------------

    def _settle(self, seen: BatteryObservation, dt_s: float) -> None:
        counts = self._counts
        start = counts.start_wh
        if start is None:
            return
        left, std, source = self._lowest(start)
        warnings = self._warnings(start, seen)
        ceiling = self._voltage_ceiling_wh()
        if counts.started and ceiling is not None and ceiling < left:
            left, source = ceiling, "loaded voltage"
            warnings.append(f"voltage under load allows no more than {ceiling:.0f} Wh")
        left = max(left, 0.0)
        possible = self._least_possible_wh(dt_s)
        if counts.left_wh is not None:
            counts.slack_wh = max(counts.slack_wh - (counts.left_wh - max(left, possible)), 0.0)
        doubt = max(0.5 * (possible - left), self._unconfirmed_wh())
        left = max(left, possible)
        if counts.left_wh is None or left <= counts.left_wh:
            counts.left_wh, counts.source = left, source
        widest_wh = _NOTHING_KNOWN_FRAC * counts.usable_full_wh
        counts.left_std_wh = min(math.hypot(std, doubt), widest_wh)
        counts.warnings = warnings

    def _least_possible_wh(self, dt_s: float) -> float:
        """What is left at least, had it drawn the most that it can and not what was counted."""
        counts = self._counts
        if counts.left_wh is None or not counts.started:
            return 0.0
        most_wh = self._most_w * dt_s / 3600.0
        whole_wh = _WHOLE_FRAC * counts.usable_full_wh
        counts.slack_wh = max(min(counts.slack_wh + most_wh, whole_wh), most_wh)
        return max(counts.left_wh - counts.slack_wh, 0.0)

    def _unconfirmed_wh(self) -> float:
        """How far a reading that is not believed yet widens the belief (one sigma)."""
        doubted = max((g.percentage.doubt_frac for g in self._counts.gauges.values()), default=0.0)
        return min(0.5 * doubted, _UNCONFIRMED_FRAC) * self._counts.usable_full_wh

    def _lowest(self, start_wh: float) -> tuple[float, float, str]:
        """(left, standard deviation, source) by the source that leaves least."""
        counts = self._counts
        used = self._consumed()
        source = max(used, key=lambda name: used[name])
        frac = _MODEL_STD_FRAC if source == "power model" else _COUNTER_STD_FRAC
        std = math.hypot(counts.start_std_wh, frac * used[source])
        left, name = start_wh - used[source], f"{counts.start_source} less {source}"
        by_percentage = self._by_percentage_wh()
        if by_percentage is not None and by_percentage < left:
            left, name = by_percentage, "autopilot's percentage"
        return left, std, name

    def _by_percentage_wh(self) -> float | None:
        least = self._least_percentage()
        return None if least is None else least * self._counts.usable_full_wh

    def _least_percentage(self) -> float | None:
        """Of the pack, or the message, that tells least."""
        told = [g.percentage.left_frac for g in self._counts.gauges.values()]
        return min((frac for frac in told if frac is not None), default=None)

    def _most_counted_wh(self) -> tuple[float | None, float | None]:
        """(energy counters, charge counters): the one that counted most of each."""
        energy = [g.energy.counted_wh for g in self._counts.gauges.values()]
        charge = [g.charge.counted_wh for g in self._counts.gauges.values()]
        return (
            max((wh for wh in energy if wh is not None), default=None),
            max((wh for wh in charge if wh is not None), default=None),
        )

    def _consumed(self) -> dict[str, float]:
        counts = self._counts
        energy_wh, charge_wh = self._most_counted_wh()
        heard = {
            "voltage x current": counts.current_wh,
            "autopilot's energy counter": energy_wh,
            "autopilot's charge counter": charge_wh,
        }
        used = {name: wh for name, wh in heard.items() if wh is not None}
        if counts.current_wh is not None:
            used["voltage x current"] = counts.current_wh + counts.unmeasured_wh
        most = max(used.values(), default=0.0)
        if not used or self._undercounts(most):
            used["power model"] = counts.modelled_wh
        return used

    def _undercounts(self, measured_wh: float) -> bool:
        modelled = self._counts.modelled_wh
        return modelled > _JUDGE_COUNTERS_WH and measured_wh < _UNDERCOUNT_FRAC * modelled

    def _voltage_ceiling_wh(self) -> float | None:
        cell_v = self._counts.loaded_cell_v
        if cell_v is None:
            return None
        battery = self._battery
        high_v = (cell_v + _CEILING_SIGMAS * _LOADED_CELL_STD_V) * battery.cells
        return self._counts.usable_full_wh * self._above_cutoff(battery.charge_frac_at_rest(high_v))

    def _warnings(self, start_wh: float, seen: BatteryObservation) -> list[str]:
        counts = self._counts
        warnings: list[str] = []
        if seen.voltage_v is not None and not self._plausible(seen.voltage_v):
            warnings.append(
                f"{seen.voltage_v:.1f} V does not fit {self._battery.cells} cells: not used"
            )
        if counts.start_source != "resting voltage":
            warnings.append(f"energy at the start is from: {counts.start_source}")
        if seen.remaining_is_timer:
            warnings.append("the autopilot's percentage counts time, not energy: not used")
        used = self._consumed()
        if "power model" in used and counts.modelled_wh > _JUDGE_COUNTERS_WH:
            why = "counts less than the power model" if len(used) > 1 else "measures no consumption"
            warnings.append(f"the autopilot {why}: energy by the power model")
        lefts = {name: start_wh - wh for name, wh in used.items()}
        by_percentage = self._by_percentage_wh()
        if by_percentage is not None:
            lefts["autopilot's percentage"] = by_percentage
        low, high = min(lefts, key=lambda n: lefts[n]), max(lefts, key=lambda n: lefts[n])
        if lefts[high] - lefts[low] > _DISAGREE_FRAC * counts.usable_full_wh:
            warnings.append(
                f"{low} leaves {max(lefts[low], 0.0):.0f} Wh, {high} {lefts[high]:.0f} Wh:"
                " the lowest counts"
            )
        return warnings


def cutoff_charge_frac(battery: BatteryPack, draw_w: float) -> float:
    """Charge at which the loaded voltage meets the cut-off at this draw."""
    loaded_v = battery.cutoff_cell_v * battery.cells
    sag_v = draw_w / loaded_v * battery.resistance_ohm
    return min(battery.charge_frac_at_rest(loaded_v + sag_v), 0.9)


def most_power_w(airframe: Airframe, density_kgpm3: float) -> float:
    """The most that this vehicle can draw, in trouble: loaded, climbing at its top airspeed."""
    mass_kg = airframe.mass_kg(airframe.mass.max_payload_kg)
    top_mps = max_airspeed_mps(airframe, mass_kg, density_kgpm3)
    climb_mps = airframe.speeds.climb_mps
    drawn_w = multirotor_power_w(airframe, mass_kg, top_mps, climb_mps, density_kgpm3)
    return _DRAW_TIMES * float(drawn_w)


def _positive(value: float | None) -> bool:
    return value is not None and value > 0.0


def _finite(seen: BatteryObservation) -> BatteryObservation:
    """The same with NaN, infinities and negatives (the wire's -1) as unknown."""

    def known(value: float | None) -> float | None:
        return value if value is not None and math.isfinite(value) and value >= 0.0 else None

    celsius = seen.temperature_c
    cold = celsius is not None and math.isfinite(celsius) and -60.0 <= celsius <= 90.0
    remaining = known(seen.remaining_frac)
    return replace(
        seen,
        voltage_v=known(seen.voltage_v),
        current_a=known(seen.current_a),
        consumed_mah=known(seen.consumed_mah),
        consumed_wh=known(seen.consumed_wh),
        remaining_frac=min(remaining, 1.0) if remaining is not None else None,
        temperature_c=celsius if cold else None,
        modelled_power_w=known(seen.modelled_power_w),
    )
