"""Flights as calibration takes them: checked, put on one clock, and averaged over 2 s.

A record is what any log gives; what is unknown is NaN. What is missing, cut off or in a wrong
unit is said with the flight's name and row; what is left is used as far as it goes.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.vehicle.power import GRAVITY_MPS2

BLOCK_S = 2.0
_GRID_S = 0.1
_GAP_S = 1.5  # telemetry that pauses for longer leaves its blocks out
_LEAST_AIRBORNE_S = 60.0
_TILT_LIMIT_RAD = 1.2
_FASTEST_MPS = 80.0
_HIGHEST_CELL_V = 4.6
_POWER_LEAST_FRAC = 0.35  # of the expected hover power: less is on the ground


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """One flight's telemetry, one row a time; NaN where unknown.

    `vel_ned_mps` (n, 3); attitude in rad; voltage and current of the pack. `payload_kg` is what
    hung below, for every row. `density_kgpm3` of the air that it flew in.
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
    specific forces, m/s^2; `cos_yaw`, `sin_yaw` the mean of the heading's direction, which is what
    a steady wind is projected with. `swing_mps2` says how much the thrust moved within the block.
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

    def pick(self, keep: Bools | Ints) -> "Blocks":
        """The blocks that are kept, by truth or by number."""
        return replace(self, **_picked(self, keep))


@dataclass(frozen=True, slots=True)
class Prepared:
    """A flight's blocks, and what had to be said about its log."""

    blocks: Blocks
    notes: tuple[str, ...]

    @property
    def cut_short(self) -> bool:
        """The log ends in the air."""
        return bool(self.blocks.airborne[-1])


def prepare(record: FlightRecord, hover_w: float, cells: int) -> Prepared:
    """Blocks of a record; LeewayError names flight and row where it cannot be used.

    `hover_w` (the start airframe's) tells flight from standing and watt from milliwatt.
    """
    notes: list[str] = []
    record = _in_order(record, notes)
    _check_units(record, hover_w, cells)
    grid_s = np.arange(record.t_s[0], record.t_s[-1], _GRID_S)
    per_block = round(BLOCK_S / _GRID_S)
    count = len(grid_s) // per_block
    if count < 3:
        raise LeewayError(f"{record.name}: {record.t_s[-1] - record.t_s[0]:.1f} s, too short")
    grid_s = grid_s[: count * per_block]
    blocks, usable = _blocks(record, grid_s, per_block, hover_w)
    missing = int(np.count_nonzero(~usable))
    if missing:
        notes.append(
            f"{record.name}: {missing * BLOCK_S:.0f} s left out (attitude, velocity, voltage or"
            " current is missing there)"
        )
    blocks = blocks.pick(usable)
    airborne_s = float(np.count_nonzero(blocks.airborne)) * BLOCK_S
    if airborne_s < _LEAST_AIRBORNE_S:
        raise LeewayError(
            f"{record.name}: {airborne_s:.0f} s of flight with attitude, velocity, voltage and"
            f" current, at least {_LEAST_AIRBORNE_S:.0f} s expected"
        )
    prepared = Prepared(blocks, tuple(notes))
    if not prepared.cut_short:
        return prepared
    words = f"{record.name}: cut off in flight at {blocks.t_s[-1]:.0f} s; used up to there"
    return Prepared(blocks, (*notes, words))


def _in_order(record: FlightRecord, notes: list[str]) -> FlightRecord:
    """Rows with rising, finite time; a clock that jumps is said by its row."""
    if len(record.t_s) < 2:
        raise LeewayError(f"{record.name}: {len(record.t_s)} rows, at least 2 expected")
    finite = np.isfinite(record.t_s)
    if not finite.all():
        row = int(np.flatnonzero(~finite)[0])
        notes.append(f"{record.name}: row {row}: t_s is no number; such rows left out")
    latest = np.maximum.accumulate(np.where(finite, record.t_s, -np.inf))
    rising = finite & np.r_[True, record.t_s[1:] > latest[:-1]]
    if not rising[finite].all():
        row = int(np.flatnonzero(finite & ~rising)[0])
        notes.append(
            f"{record.name}: row {row}: time does not rise; rows up to the old time left out"
        )
    return replace(record, **_picked(record, rising))


def _picked(table: FlightRecord | Blocks, keep: Bools | Ints) -> dict[str, Any]:
    """Rows of every column."""
    columns = {name: getattr(table, name) for name in table.__slots__}
    return {name: c[keep] for name, c in columns.items() if isinstance(c, np.ndarray)}


def _check_units(record: FlightRecord, hover_w: float, cells: int) -> None:
    """Values of a wrong scale are refused by name; one sensor missing altogether too."""
    _present(record, "roll_rad", record.roll_rad, "attitude")
    _present(record, "pitch_rad", record.pitch_rad, "attitude")
    _present(record, "yaw_rad", record.yaw_rad, "heading")
    _present(record, "vel_ned_mps", record.vel_ned_mps[:, 0], "velocity over ground")
    _present(record, "voltage_v", record.voltage_v, "the pack's voltage")
    _present(record, "current_a", record.current_a, "the pack's current (a power module)")
    _within(record, "roll_rad", record.roll_rad, np.pi + 0.01, "rad")
    _within(record, "pitch_rad", record.pitch_rad, np.pi / 2 + 0.01, "rad")
    _within(record, "yaw_rad", record.yaw_rad, 2 * np.pi + 0.01, "rad")
    speed = np.linalg.norm(record.vel_ned_mps, axis=1)
    _within(record, "vel_ned_mps", speed, _FASTEST_MPS, "m/s")
    _within(record, "voltage_v", record.voltage_v, cells * _HIGHEST_CELL_V, f"V for {cells} cells")
    highest_v = float(np.nanpercentile(record.voltage_v, 95))
    if highest_v < cells * 2.5:
        raise LeewayError(
            f"{record.name}: voltage_v: {highest_v:.2f} V, {cells * 2.5:.1f} V or more expected of"
            f" {cells} cells"
        )
    drawn = record.voltage_v * record.current_a
    typical_w = float(np.nanpercentile(drawn, 80)) if np.isfinite(drawn).any() else _pair(record)
    if typical_w > 5.0 * hover_w or typical_w < 0.2 * hover_w:
        raise LeewayError(
            f"{record.name}: current_a: voltage times current is {typical_w:.4g} W, and about"
            f" {hover_w:.0f} W expected in hover: wrong unit, sensor off, or another vehicle"
        )


def _pair(record: FlightRecord) -> float:
    """Power where voltage and current come in rows of their own."""
    return float(np.nanmedian(record.voltage_v) * np.nanpercentile(record.current_a, 80))


def _present(record: FlightRecord, key: str, values: Floats, what: str) -> None:
    if not np.isfinite(values).any():
        raise LeewayError(f"{record.name}: {key}: no row has it; {what} is needed to calibrate")


def _within(record: FlightRecord, key: str, values: Floats, limit: float, unit: str) -> None:
    beyond = np.flatnonzero(np.abs(values) > limit)  # NaN compares as within
    if len(beyond) > 0.01 * len(values):
        row = int(beyond[0])
        raise LeewayError(
            f"{record.name}: row {row}: {key} is {values[row]:.6g}, at most {limit:.4g} expected"
            f" ({unit}): wrong unit?"
        )


def _blocks(
    record: FlightRecord, grid_s: Floats, per_block: int, hover_w: float
) -> tuple[Blocks, Bools]:
    """All blocks of the grid, and which of them every sensor covers."""
    vel = [_on_grid(record.t_s, record.vel_ned_mps[:, i], grid_s) for i in range(3)]
    roll, roll_ok = _on_grid(record.t_s, record.roll_rad, grid_s)
    pitch, pitch_ok = _on_grid(record.t_s, record.pitch_rad, grid_s)
    yaw, yaw_ok = _on_grid(record.t_s, record.yaw_rad, grid_s, angle=True)
    volt, volt_ok = _on_grid(record.t_s, record.voltage_v, grid_s, gap_s=6.0)
    current, current_ok = _on_grid(record.t_s, record.current_a, grid_s, gap_s=6.0)
    payload, _ = _on_grid(record.t_s, record.payload_kg, grid_s, gap_s=np.inf)
    (north, ok_n), (east, ok_e), (down, ok_d) = vel
    accel_n, accel_e, accel_d = (np.gradient(v, _GRID_S) for v in (north, east, down))
    jerk_n, jerk_e = (_slope(_slope(v)) for v in (north, east))
    ok = roll_ok & pitch_ok & yaw_ok & volt_ok & current_ok & ok_n & ok_e & ok_d
    ok &= np.maximum(np.abs(roll), np.abs(pitch)) < _TILT_LIMIT_RAD
    cos, sin = np.cos(yaw), np.sin(yaw)
    lift = np.clip(GRAVITY_MPS2 - accel_d, 0.3 * GRAVITY_MPS2, 2.0 * GRAVITY_MPS2)
    thrust_f = -lift * np.tan(pitch)
    thrust_r = lift * np.tan(roll) / np.cos(pitch)

    def mean(values: Floats) -> Floats:
        return values.reshape(-1, per_block).mean(axis=1)

    def spread(values: Floats) -> Floats:
        return np.ptp(values.reshape(-1, per_block), axis=1)

    power = volt * current
    flying = mean(power) > _POWER_LEAST_FRAC * hover_w
    blocks = Blocks(
        name=record.name,
        t_s=mean(grid_s),
        north_mps=mean(north),
        east_mps=mean(east),
        climb_mps=-mean(down),
        cos_yaw=mean(cos),
        sin_yaw=mean(sin),
        forward_mps=mean(cos * north + sin * east),
        right_mps=mean(cos * east - sin * north),
        accel_forward_mps2=mean(cos * accel_n + sin * accel_e),
        accel_right_mps2=mean(cos * accel_e - sin * accel_n),
        thrust_forward_mps2=mean(thrust_f),
        thrust_right_mps2=mean(thrust_r),
        jerk_forward_mps3=mean(cos * jerk_n + sin * jerk_e),
        jerk_right_mps3=mean(cos * jerk_e - sin * jerk_n),
        swing_mps2=np.hypot(spread(thrust_f), spread(thrust_r)),
        voltage_v=mean(volt),
        current_a=mean(current),
        power_w=mean(power),
        payload_kg=mean(payload),
        airborne=_in_the_air(flying),
        density_kgpm3=record.density_kgpm3,
    )
    return blocks, np.asarray(ok.reshape(-1, per_block).all(axis=1), np.bool_)


def _slope(values: Floats) -> Floats:
    """Rate of change over 1 s about each sample of the grid."""
    half = round(0.5 / _GRID_S)
    padded = np.pad(values, half, mode="edge")
    return (padded[2 * half :] - padded[: -2 * half]) / (2 * half * _GRID_S)


def _in_the_air(flying: Bools) -> Bools:
    """Under power, less the blocks of take-off and landing; a log's end is not a landing."""
    before, after = np.r_[False, flying[:-1]], np.r_[flying[1:], True]
    return flying & before & after


def _on_grid(
    t_s: Floats,
    values: Floats,
    grid_s: Floats,
    gap_s: float = _GAP_S,
    angle: bool = False,
) -> tuple[Floats, Bools]:
    """Linear interpolation over the rows that know the value; False within longer gaps."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros_like(grid_s), np.zeros(len(grid_s), bool)
    at, known_values = t_s[known], values[known]
    if angle:
        known_values = np.unwrap(known_values)
    after = np.clip(np.searchsorted(at, grid_s), 1, len(at) - 1) if len(at) > 1 else None
    if after is None:
        return np.full_like(grid_s, known_values[0]), np.zeros(len(grid_s), bool)
    covered = (at[after] - at[after - 1] <= gap_s) & (grid_s >= at[0] - gap_s)
    covered &= grid_s <= at[-1] + gap_s
    return np.interp(grid_s, at, known_values), covered
