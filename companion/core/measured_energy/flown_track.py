"""A recorded flight on an even grid, from the first to the last instant under power, and its legs.

Legs are found in the motion: a leg begins and ends where the vehicle comes through half of the
commanded ground speed, a corner is the slowest instant between two legs.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import offsets_m
from companion.core.replay.recorded_flight import FlightSamples

STEP_S = 0.2
_UNDER_POWER_FRAC = 0.3  # of the median power in the air: idling rotors draw a tenth
_LEAST_FLIGHT_S = 30.0
_LONGEST_GAP_S = 10.0
"""Longer, and what was drawn and flown meanwhile is a guess."""
_LANDED_M = 5.0  # above the lowest end of the track: the height of such logs wanders by that much
_LEG_SPEED_FRAC = 0.5
_LEAST_LEG_M = 25.0
_SAME_COURSE = np.cos(np.radians(30.0))


@dataclass(frozen=True, slots=True)
class FlownLeg:
    """One straight leg: grid indices where it begins and ends to move."""

    first: int
    last: int


@dataclass(frozen=True)
class FlownTrack:
    """One flight, (n,) each on a grid of STEP_S from power on to power off; about its start.

    Velocity is north, east, up. `cut_short`: the log ends in the air.
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
    cut_short: bool

    @cached_property
    def energy_wh(self) -> float:
        """Everything that it drew."""
        return self.energy_after_wh(0)

    @cached_property
    def ground_speed_mps(self) -> Floats:
        """Over 1 s, horizontally."""
        return _smooth(np.hypot(self.vel_n_mps, self.vel_e_mps), 1.0)

    @cached_property
    def accel_mps2(self) -> Floats:
        """Horizontal, over 2 s."""
        north, east = (_smooth(v, 2.0) for v in (self.vel_n_mps, self.vel_e_mps))
        return np.hypot(np.gradient(north, STEP_S), np.gradient(east, STEP_S))

    def energy_after_wh(self, index: int) -> float:
        """What it drew from this grid point on."""
        return float(self.power_w[index:].sum()) * STEP_S / 3600.0

    def place(self, index: int) -> tuple[float, float]:
        """North and east of the start, m."""
        return float(self.north_m[index]), float(self.east_m[index])


def flown_track(name: str, samples: FlightSamples, payload_kg: float) -> FlownTrack:
    """The track of a recorded flight; LeewayError where the log holds none, or has a long gap."""
    power = samples.voltage_v * samples.current_a
    known = np.isfinite(power)
    if not known.any() or not np.isfinite(samples.lat_deg).any():
        raise LeewayError(f"{name}: no row has voltage, current and position; expected all three")
    grid_s = np.arange(samples.t_s[0], samples.t_s[-1], STEP_S)
    drawn = np.interp(grid_s, samples.t_s[known], power[known])
    begin, end = _under_power(name, drawn, samples)
    span = slice(begin, end + 1)
    t_s = grid_s[span]
    _refuse_gap(name, samples.t_s[known & np.isfinite(samples.lat_deg)], t_s)
    lat, lon = (_on(t_s, samples.t_s, v) for v in (samples.lat_deg, samples.lon_deg))
    north, east = offsets_m(float(lat[0]), float(lon[0]), lat, lon)
    height = _on(t_s, samples.t_s, samples.alt_amsl_m)
    return FlownTrack(
        name=name,
        payload_kg=payload_kg,
        t_s=t_s,
        north_m=north,
        east_m=east,
        height_m=height - height[0],
        vel_n_mps=_on(t_s, samples.t_s, samples.vel_n_mps),
        vel_e_mps=_on(t_s, samples.t_s, samples.vel_e_mps),
        climb_mps=_smooth(-_on(t_s, samples.t_s, samples.vel_d_mps), 1.0),
        power_w=drawn[span],
        alt_amsl_m=float(height[0]),
        cut_short=bool(
            end >= len(grid_s) - 2 and height[-1] > min(height[0], height[-1]) + _LANDED_M
        ),
    )


def _refuse_gap(name: str, known_s: Floats, under_power_s: Floats) -> None:
    """LeewayError where power or position is unknown for long while under power."""
    inside = known_s[(known_s > under_power_s[0]) & (known_s < under_power_s[-1])]
    edges_s = np.concatenate([under_power_s[:1], inside, under_power_s[-1:]])
    longest = int(np.argmax(np.diff(edges_s)))
    gap_s = float(edges_s[longest + 1] - edges_s[longest])
    if gap_s > _LONGEST_GAP_S:
        raise LeewayError(
            f"{name}: no power or position for {gap_s:.0f} s from {edges_s[longest]:.1f} s on,"
            f" under power; at most {_LONGEST_GAP_S:g} s expected to tell its energy"
        )


def _under_power(name: str, drawn_w: Floats, samples: FlightSamples) -> tuple[int, int]:
    """First and last grid index under power."""
    if not samples.airborne.any():
        raise LeewayError(f"{name}: never in the air; nothing to price")
    flying_w = float(np.median(drawn_w[drawn_w > 0.5 * np.percentile(drawn_w, 90.0)]))
    at = np.flatnonzero(drawn_w > _UNDER_POWER_FRAC * flying_w)
    if len(at) * STEP_S < _LEAST_FLIGHT_S:
        raise LeewayError(
            f"{name}: {len(at) * STEP_S:.0f} s under power, at least {_LEAST_FLIGHT_S:.0f} expected"
        )
    return int(at[0]), int(at[-1])


def flown_legs(track: FlownTrack, speed_mps: float) -> tuple[FlownLeg, ...]:
    """The straight legs of a flight that was told to fly at this ground speed; none in a hover."""
    if speed_mps <= 0.0:
        return ()
    runs = _runs(track.ground_speed_mps > _LEG_SPEED_FRAC * speed_mps)
    legs: list[FlownLeg] = []
    for leg in (run for run in runs if _length_m(track, run) > _LEAST_LEG_M):
        if legs and _course(track, legs[-1]) @ _course(track, leg) > _SAME_COURSE:
            leg = FlownLeg(legs.pop().first, leg.last)
        legs.append(leg)
    return tuple(legs)


def corners(track: FlownTrack, legs: tuple[FlownLeg, ...]) -> tuple[int, ...]:
    """Grid index of the slowest instant between legs that follow one another."""
    return tuple(
        a.last + int(np.argmin(track.ground_speed_mps[a.last : b.first + 1]))
        for a, b in pairwise(legs)
    )


def _course(track: FlownTrack, leg: FlownLeg) -> Floats:
    (n0, e0), (n1, e1) = track.place(leg.first), track.place(leg.last)
    return np.array([n1 - n0, e1 - e0]) / max(np.hypot(n1 - n0, e1 - e0), 1e-9)


def _length_m(track: FlownTrack, leg: FlownLeg) -> float:
    (n0, e0), (n1, e1) = track.place(leg.first), track.place(leg.last)
    return float(np.hypot(n1 - n0, e1 - e0))


def _runs(mask: Bools) -> list[FlownLeg]:
    steps = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(int)))
    return [FlownLeg(int(a), int(b) - 1) for a, b in zip(steps[::2], steps[1::2], strict=True)]


def _on(grid_s: Floats, t_s: Floats, values: Floats) -> Floats:
    known = np.isfinite(values)
    return np.interp(grid_s, t_s[known], values[known])


def _smooth(values: Floats, over_s: float) -> Floats:
    """Centred mean; the ends repeat."""
    half = max(round(over_s / STEP_S) // 2, 1)
    padded = np.pad(values, half, mode="edge")
    return np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid")
