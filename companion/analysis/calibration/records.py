"""Flights as input of a calibration: validated, resampled to one clock, averaged over 2 s.

A record is the common content of all log formats; unknown values are NaN. Missing data, a truncated
log and wrong units are reported with the flight's name and row; the rest is used.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.vehicle.power import GRAVITY_MPS2

BLOCK_S = 2.0
_GRID_S = 0.1
_GAP_S = 1.5  # blocks within a longer telemetry gap are excluded
_MIN_AIRBORNE_S = 60.0
_TILT_LIMIT_RAD = 1.2
_MAX_SPEED_MPS = 80.0
_MAX_CELL_V = 4.6
_MIN_POWER_FRAC = 0.35  # of the expected hover power: below it the vehicle is on the ground


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """One flight's telemetry, one row a time; NaN where unknown.

    `vel_ned_mps` (n, 3); attitude in rad; voltage and current of the pack. `payload_kg` is the
    carried mass in each row, `density_kgpm3` the air density.
    """

    name: str
    t_s: Floats
    vel_ned_mps: Floats
    roll_rad: Floats
    pitch_rad: Floats
    yaw_rad: Floats
    voltage_v: Floats
    current_a: Floats
    payload_kg: Floats
    density_kgpm3: float


@dataclass(frozen=True, slots=True)
class Blocks:
    """Means over `BLOCK_S` of one flight's usable stretches; all arrays (n,).

    Forward and right are along the heading (level). `thrust_*` and `accel_*` are horizontal
    specific forces, m/s^2; `cos_yaw`, `sin_yaw` the mean heading vector, which projects a steady
    wind. `swing_mps2` is the range of the thrust within the block.
    """

    name: str
    t_s: Floats
    north_mps: Floats
    east_mps: Floats
    climb_mps: Floats
    cos_yaw: Floats
    sin_yaw: Floats
    forward_mps: Floats
    right_mps: Floats
    accel_forward_mps2: Floats
    accel_right_mps2: Floats
    thrust_forward_mps2: Floats
    thrust_right_mps2: Floats
    jerk_forward_mps3: Floats
    jerk_right_mps3: Floats
    swing_mps2: Floats
    voltage_v: Floats
    current_a: Floats
    power_w: Floats
    payload_kg: Floats
    airborne: Bools
    density_kgpm3: float

    def select(self, mask_or_indices: Bools | Ints) -> "Blocks":
        """Return selected blocks, by mask or by index."""
        return replace(self, **_selected_rows(self, mask_or_indices))


@dataclass(frozen=True, slots=True)
class PreparedFlight:
    """A flight's blocks, and notes on its log."""

    blocks: Blocks
    notes: tuple[str, ...]

    @property
    def ends_in_flight(self) -> bool:
        """Whether the log ends in flight."""
        return bool(self.blocks.airborne[-1])


def convert_record_to_blocks(
    record: FlightRecord, expected_hover_power_w: float, cells: int
) -> PreparedFlight:
    """Convert a record to blocks; raises LeewayError with flight and row if it is unusable.

    `expected_hover_power_w` (of the start airframe) separates flight from ground time and watt from
    milliwatt.
    """
    notes: list[str] = []
    record = _with_monotonic_time(record, notes)
    _raise_if_units_implausible(record, expected_hover_power_w, cells)
    grid_s = np.arange(record.t_s[0], record.t_s[-1], _GRID_S)
    per_block = round(BLOCK_S / _GRID_S)
    count = len(grid_s) // per_block
    if count < 3:
        raise LeewayError(f"{record.name}: {record.t_s[-1] - record.t_s[0]:.1f} s; expected 6 s")
    grid_s = grid_s[: count * per_block]
    blocks, usable = _blocks_and_covered_mask(record, grid_s, per_block, expected_hover_power_w)
    missing = int(np.count_nonzero(~usable))
    if missing:
        notes.append(
            f"{record.name}: {missing * BLOCK_S:.0f} s excluded (attitude, velocity, voltage or"
            " current is missing there)"
        )
    blocks = blocks.select(usable)
    airborne_s = float(np.count_nonzero(blocks.airborne)) * BLOCK_S
    if airborne_s < _MIN_AIRBORNE_S:
        raise LeewayError(
            f"{record.name}: {airborne_s:.0f} s of flight with attitude, velocity, voltage and"
            f" current, at least {_MIN_AIRBORNE_S:.0f} s expected"
        )
    prepared = PreparedFlight(blocks, tuple(notes))
    if not prepared.ends_in_flight:
        return prepared
    words = f"{record.name}: cut off in flight at {blocks.t_s[-1]:.0f} s; used up to there"
    return PreparedFlight(blocks, (*notes, words))


def _with_monotonic_time(record: FlightRecord, notes: list[str]) -> FlightRecord:
    """Return rows with increasing, finite time; note the row of a clock jump."""
    if len(record.t_s) < 2:
        raise LeewayError(f"{record.name}: {len(record.t_s)} rows, at least 2 expected")
    finite = np.isfinite(record.t_s)
    if not finite.all():
        row = int(np.flatnonzero(~finite)[0])
        notes.append(f"{record.name}: row {row}: t_s is not a number; such rows excluded")
    latest = np.maximum.accumulate(np.where(finite, record.t_s, -np.inf))
    rising = finite & np.r_[True, record.t_s[1:] > latest[:-1]]
    if not rising[finite].all():
        row = int(np.flatnonzero(finite & ~rising)[0])
        notes.append(
            f"{record.name}: row {row}: time does not rise; rows up to the old time excluded"
        )
    return replace(record, **_selected_rows(record, rising))


def _selected_rows(table: FlightRecord | Blocks, mask_or_indices: Bools | Ints) -> dict[str, Any]:
    """Select rows of each column."""
    columns = {name: getattr(table, name) for name in table.__slots__}
    return {name: c[mask_or_indices] for name, c in columns.items() if isinstance(c, np.ndarray)}


def _raise_if_units_implausible(record: FlightRecord, hover_w: float, cells: int) -> None:
    """Raise LeewayError for a missing sensor or values of a wrong scale."""
    _raise_if_no_finite_value(record, "roll_rad", record.roll_rad, "attitude")
    _raise_if_no_finite_value(record, "pitch_rad", record.pitch_rad, "attitude")
    _raise_if_no_finite_value(record, "yaw_rad", record.yaw_rad, "heading")
    _raise_if_no_finite_value(
        record, "vel_ned_mps", record.vel_ned_mps[:, 0], "velocity over ground"
    )
    _raise_if_no_finite_value(record, "voltage_v", record.voltage_v, "the pack's voltage")
    _raise_if_no_finite_value(
        record, "current_a", record.current_a, "the pack's current (a power module)"
    )
    _raise_if_many_outliers(record, "roll_rad", record.roll_rad, np.pi + 0.01, "rad")
    _raise_if_many_outliers(record, "pitch_rad", record.pitch_rad, np.pi / 2 + 0.01, "rad")
    _raise_if_many_outliers(record, "yaw_rad", record.yaw_rad, 2 * np.pi + 0.01, "rad")
    speed = np.linalg.norm(record.vel_ned_mps, axis=1)
    _raise_if_many_outliers(record, "vel_ned_mps", speed, _MAX_SPEED_MPS, "m/s")
    _raise_if_many_outliers(
        record, "voltage_v", record.voltage_v, cells * _MAX_CELL_V, f"V for {cells} cells"
    )
    highest_v = float(np.nanpercentile(record.voltage_v, 95))
    if highest_v < cells * 2.5:
        raise LeewayError(
            f"{record.name}: voltage_v: {highest_v:.2f} V, {cells * 2.5:.1f} V or more expected of"
            f" {cells} cells"
        )
    drawn = record.voltage_v * record.current_a
    typical_w = (
        float(np.nanpercentile(drawn, 80)) if np.isfinite(drawn).any() else _typical_power_w(record)
    )
    if typical_w > 5.0 * hover_w or typical_w < 0.2 * hover_w:
        raise LeewayError(
            f"{record.name}: current_a: voltage times current is {typical_w:.4g} W, and about"
            f" {hover_w:.0f} W expected in hover: wrong unit, sensor off, or another vehicle"
        )


def _typical_power_w(record: FlightRecord) -> float:
    """Return typical power if voltage and current are in separate rows."""
    return float(np.nanmedian(record.voltage_v) * np.nanpercentile(record.current_a, 80))


def _raise_if_no_finite_value(
    record: FlightRecord, key: str, values: Floats, sensor_name: str
) -> None:
    if not np.isfinite(values).any():
        raise LeewayError(f"{record.name}: {key}: no value; calibration requires {sensor_name}")


def _raise_if_many_outliers(
    record: FlightRecord, key: str, values: Floats, max_magnitude: float, unit: str
) -> None:
    outliers = np.flatnonzero(np.abs(values) > max_magnitude)  # NaN compares as within
    if len(outliers) > 0.01 * len(values):
        row = int(outliers[0])
        raise LeewayError(
            f"{record.name}: row {row}: {key} is {values[row]:.6g}, at most {max_magnitude:.4g}"
            f" expected ({unit}): wrong unit?"
        )


def _blocks_and_covered_mask(
    record: FlightRecord, grid_s: Floats, samples_per_block: int, hover_w: float
) -> tuple[Blocks, Bools]:
    """Return all blocks of the grid, and a mask of those that every sensor covers."""
    vel = [
        _interpolate_with_covered_mask(record.t_s, record.vel_ned_mps[:, i], grid_s)
        for i in range(3)
    ]
    roll, roll_ok = _interpolate_with_covered_mask(record.t_s, record.roll_rad, grid_s)
    pitch, pitch_ok = _interpolate_with_covered_mask(record.t_s, record.pitch_rad, grid_s)
    yaw, yaw_ok = _interpolate_with_covered_mask(
        record.t_s, record.yaw_rad, grid_s, is_angle_rad=True
    )
    volt, volt_ok = _interpolate_with_covered_mask(
        record.t_s, record.voltage_v, grid_s, max_gap_s=6.0
    )
    current, current_ok = _interpolate_with_covered_mask(
        record.t_s, record.current_a, grid_s, max_gap_s=6.0
    )
    payload, _ = _interpolate_with_covered_mask(
        record.t_s, record.payload_kg, grid_s, max_gap_s=np.inf
    )
    (north, ok_n), (east, ok_e), (down, ok_d) = vel
    accel_n, accel_e, accel_d = (np.gradient(v, _GRID_S) for v in (north, east, down))
    jerk_n, jerk_e = (_rate_of_change_over_1_s(_rate_of_change_over_1_s(v)) for v in (north, east))
    ok = roll_ok & pitch_ok & yaw_ok & volt_ok & current_ok & ok_n & ok_e & ok_d
    ok &= np.maximum(np.abs(roll), np.abs(pitch)) < _TILT_LIMIT_RAD
    cos, sin = np.cos(yaw), np.sin(yaw)
    lift = np.clip(GRAVITY_MPS2 - accel_d, 0.3 * GRAVITY_MPS2, 2.0 * GRAVITY_MPS2)
    thrust_f = -lift * np.tan(pitch)
    thrust_r = lift * np.tan(roll) / np.cos(pitch)

    def block_mean(values: Floats) -> Floats:
        return values.reshape(-1, samples_per_block).mean(axis=1)

    def block_range(values: Floats) -> Floats:
        return np.ptp(values.reshape(-1, samples_per_block), axis=1)

    power = volt * current
    is_powered = block_mean(power) > _MIN_POWER_FRAC * hover_w
    blocks = Blocks(
        name=record.name,
        t_s=block_mean(grid_s),
        north_mps=block_mean(north),
        east_mps=block_mean(east),
        climb_mps=-block_mean(down),
        cos_yaw=block_mean(cos),
        sin_yaw=block_mean(sin),
        forward_mps=block_mean(cos * north + sin * east),
        right_mps=block_mean(cos * east - sin * north),
        accel_forward_mps2=block_mean(cos * accel_n + sin * accel_e),
        accel_right_mps2=block_mean(cos * accel_e - sin * accel_n),
        thrust_forward_mps2=block_mean(thrust_f),
        thrust_right_mps2=block_mean(thrust_r),
        jerk_forward_mps3=block_mean(cos * jerk_n + sin * jerk_e),
        jerk_right_mps3=block_mean(cos * jerk_e - sin * jerk_n),
        swing_mps2=np.hypot(block_range(thrust_f), block_range(thrust_r)),
        voltage_v=block_mean(volt),
        current_a=block_mean(current),
        power_w=block_mean(power),
        payload_kg=block_mean(payload),
        airborne=_airborne_block_mask(is_powered),
        density_kgpm3=record.density_kgpm3,
    )
    return blocks, np.asarray(ok.reshape(-1, samples_per_block).all(axis=1), np.bool_)


def _rate_of_change_over_1_s(values: Floats) -> Floats:
    """Return the rate of change over 1 s centred at each sample."""
    half = round(0.5 / _GRID_S)
    padded = np.pad(values, half, mode="edge")
    return (padded[2 * half :] - padded[: -2 * half]) / (2 * half * _GRID_S)


def _airborne_block_mask(is_powered: Bools) -> Bools:
    """Return the powered blocks without take-off and landing; a log's end is no landing."""
    before, after = np.r_[False, is_powered[:-1]], np.r_[is_powered[1:], True]
    return is_powered & before & after


def _interpolate_with_covered_mask(
    t_s: Floats,
    values: Floats,
    grid_s: Floats,
    max_gap_s: float = _GAP_S,
    is_angle_rad: bool = False,
) -> tuple[Floats, Bools]:
    """Interpolate known values linearly; the mask is False within longer gaps."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros_like(grid_s), np.zeros(len(grid_s), bool)
    at, known_values = t_s[known], values[known]
    if is_angle_rad:
        known_values = np.unwrap(known_values)
    after = np.clip(np.searchsorted(at, grid_s), 1, len(at) - 1) if len(at) > 1 else None
    if after is None:
        return np.full_like(grid_s, known_values[0]), np.zeros(len(grid_s), bool)
    covered = (at[after] - at[after - 1] <= max_gap_s) & (grid_s >= at[0] - max_gap_s)
    covered &= grid_s <= at[-1] + max_gap_s
    return np.interp(grid_s, at, known_values), covered
