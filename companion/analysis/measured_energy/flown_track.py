"""A recorded flight on a uniform time grid, from power on to power off, and its legs.

Legs are detected from the motion: a leg starts and ends at half of the commanded ground speed, a
corner is the slowest instant between two legs.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from companion.analysis.replay.recorded_flight import FlightSamples
from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import ne_offset_arrays_m

STEP_S = 0.2
_UNDER_POWER_FRAC = 0.3  # of the median airborne power: idling rotors draw a tenth
_MIN_FLIGHT_S = 30.0
_MAX_GAP_S = 10.0
"""Longest gap for which power and motion are interpolated."""
_MAX_LANDED_HEIGHT_M = (
    5.0  # above the lower end of the track: the height of such logs drifts by that much
)
_LEG_SPEED_FRAC = 0.5
_MIN_LEG_M = 25.0
_MIN_COURSE_COSINE = np.cos(np.radians(30.0))


@dataclass(frozen=True, slots=True)
class FlownLeg:
    """One straight leg: grid indices of its start and end."""

    first: int
    last: int


@dataclass(frozen=True)
class FlownTrack:
    """One flight, (n,) each on a grid of STEP_S from power on to power off; origin at the start.

    Velocity is north, east, up. `ends_in_flight`: the log ends in the air.
    """

    name: str
    payload_kg: float
    t_s: Floats
    north_m: Floats
    east_m: Floats
    height_m: Floats
    vel_n_mps: Floats
    vel_e_mps: Floats
    climb_mps: Floats
    power_w: Floats
    alt_amsl_m: float
    ends_in_flight: bool

    @cached_property
    def energy_wh(self) -> float:
        """Total energy of the flight."""
        return self.energy_from_index_to_end_wh(0)

    @cached_property
    def ground_speed_mps(self) -> Floats:
        """Horizontal ground speed, averaged over 1 s."""
        return _moving_average(np.hypot(self.vel_n_mps, self.vel_e_mps), 1.0)

    @cached_property
    def accel_mps2(self) -> Floats:
        """Horizontal acceleration, averaged over 2 s."""
        north, east = (_moving_average(v, 2.0) for v in (self.vel_n_mps, self.vel_e_mps))
        return np.hypot(np.gradient(north, STEP_S), np.gradient(east, STEP_S))

    def energy_from_index_to_end_wh(self, grid_index: int) -> float:
        """Return the energy from this grid point to the end."""
        return float(self.power_w[grid_index:].sum()) * STEP_S / 3600.0

    def position_ne_m(self, grid_index: int) -> tuple[float, float]:
        """Return the position north and east of the start, m."""
        return float(self.north_m[grid_index]), float(self.east_m[grid_index])


def build_flown_track(name: str, samples: FlightSamples, payload_kg: float) -> FlownTrack:
    """Return the track of a recorded flight. Raises LeewayError for missing data or a long gap."""
    power = samples.voltage_v * samples.current_a
    known = np.isfinite(power)
    if not known.any() or not np.isfinite(samples.lat_deg).any():
        raise LeewayError(f"{name}: no row has voltage, current and position; expected all three")
    grid_s = np.arange(samples.t_s[0], samples.t_s[-1], STEP_S)
    drawn = np.interp(grid_s, samples.t_s[known], power[known])
    begin, end = _first_and_last_index_under_power(name, drawn, samples)
    span = slice(begin, end + 1)
    t_s = grid_s[span]
    _raise_if_long_gap_under_power(name, samples.t_s[known & np.isfinite(samples.lat_deg)], t_s)
    lat, lon = (
        _interpolate_finite(t_s, samples.t_s, v) for v in (samples.lat_deg, samples.lon_deg)
    )
    north, east = ne_offset_arrays_m(float(lat[0]), float(lon[0]), lat, lon)
    height = _interpolate_finite(t_s, samples.t_s, samples.alt_amsl_m)
    return FlownTrack(
        name=name,
        payload_kg=payload_kg,
        t_s=t_s,
        north_m=north,
        east_m=east,
        height_m=height - height[0],
        vel_n_mps=_interpolate_finite(t_s, samples.t_s, samples.vel_n_mps),
        vel_e_mps=_interpolate_finite(t_s, samples.t_s, samples.vel_e_mps),
        climb_mps=_moving_average(-_interpolate_finite(t_s, samples.t_s, samples.vel_d_mps), 1.0),
        power_w=drawn[span],
        alt_amsl_m=float(height[0]),
        ends_in_flight=bool(
            end >= len(grid_s) - 2
            and height[-1] > min(height[0], height[-1]) + _MAX_LANDED_HEIGHT_M
        ),
    )


def _raise_if_long_gap_under_power(name: str, known_s: Floats, under_power_s: Floats) -> None:
    """Raise LeewayError for a long gap of power or position under power."""
    inside = known_s[(known_s > under_power_s[0]) & (known_s < under_power_s[-1])]
    edges_s = np.concatenate([under_power_s[:1], inside, under_power_s[-1:]])
    longest = int(np.argmax(np.diff(edges_s)))
    gap_s = float(edges_s[longest + 1] - edges_s[longest])
    if gap_s > _MAX_GAP_S:
        raise LeewayError(
            f"{name}: no power or position for {gap_s:.0f} s from {edges_s[longest]:.1f} s on,"
            f" under power; at most {_MAX_GAP_S:g} s expected to measure energy"
        )


def _first_and_last_index_under_power(
    name: str, drawn_w: Floats, samples: FlightSamples
) -> tuple[int, int]:
    """Return the first and last grid index under power."""
    if not samples.airborne.any():
        raise LeewayError(f"{name}: never in the air; expected a flight")
    airborne_power_w = float(np.median(drawn_w[drawn_w > 0.5 * np.percentile(drawn_w, 90.0)]))
    at = np.flatnonzero(drawn_w > _UNDER_POWER_FRAC * airborne_power_w)
    if len(at) * STEP_S < _MIN_FLIGHT_S:
        raise LeewayError(
            f"{name}: {len(at) * STEP_S:.0f} s under power, at least {_MIN_FLIGHT_S:.0f} expected"
        )
    return int(at[0]), int(at[-1])


def detect_leg_sequence(
    track: FlownTrack, commanded_ground_speed_mps: float
) -> tuple[FlownLeg, ...]:
    """Return the straight legs of a flight at this commanded ground speed; none for a hover."""
    if commanded_ground_speed_mps <= 0.0:
        return ()
    motion_spans = _true_intervals(
        track.ground_speed_mps > _LEG_SPEED_FRAC * commanded_ground_speed_mps
    )
    leg_sequence: list[FlownLeg] = []
    for leg in (run for run in motion_spans if _leg_length_m(track, run) > _MIN_LEG_M):
        if (
            leg_sequence
            and _leg_unit_vector_ne(track, leg_sequence[-1]) @ _leg_unit_vector_ne(track, leg)
            > _MIN_COURSE_COSINE
        ):
            leg = FlownLeg(leg_sequence.pop().first, leg.last)
        leg_sequence.append(leg)
    return tuple(leg_sequence)


def slowest_indices_between_legs(
    track: FlownTrack, leg_sequence: tuple[FlownLeg, ...]
) -> tuple[int, ...]:
    """Return the grid index of the slowest instant between consecutive legs."""
    return tuple(
        a.last + int(np.argmin(track.ground_speed_mps[a.last : b.first + 1]))
        for a, b in pairwise(leg_sequence)
    )


def _leg_unit_vector_ne(track: FlownTrack, leg: FlownLeg) -> Floats:
    (n0, e0), (n1, e1) = track.position_ne_m(leg.first), track.position_ne_m(leg.last)
    return np.array([n1 - n0, e1 - e0]) / max(np.hypot(n1 - n0, e1 - e0), 1e-9)


def _leg_length_m(track: FlownTrack, leg: FlownLeg) -> float:
    (n0, e0), (n1, e1) = track.position_ne_m(leg.first), track.position_ne_m(leg.last)
    return float(np.hypot(n1 - n0, e1 - e0))


def _true_intervals(mask: Bools) -> list[FlownLeg]:
    steps = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(int)))
    return [FlownLeg(int(a), int(b) - 1) for a, b in zip(steps[::2], steps[1::2], strict=True)]


def _interpolate_finite(grid_s: Floats, sample_t_s: Floats, values: Floats) -> Floats:
    known = np.isfinite(values)
    return np.interp(grid_s, sample_t_s[known], values[known])


def _moving_average(values: Floats, window_s: float) -> Floats:
    """Return the centred moving average; the edge values are repeated."""
    half = max(round(window_s / STEP_S) // 2, 1)
    padded = np.pad(values, half, mode="edge")
    return np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid")
