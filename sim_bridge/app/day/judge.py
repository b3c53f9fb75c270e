"""The verdict on a day, from truth: vehicles home, parcels delivered, least separations.

Times are the day's, positions NED metres about its depot. The beliefs of desk and companions are
not used, with one exception: the home that each vehicle reported at each moment. The truck must
keep that promise (safety rule 3).
"""

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.app.flight.judge import (
    DROP_HEIGHT_SLACK_M,
    DROP_RADIUS_M,
    HOME_RADIUS_M,
    outcome_of,
)

LEAST_FLIGHT_S = 5.0
"""Shorter airborne intervals are landing bounces, not flights."""


@dataclass(frozen=True, slots=True)
class VehicleTrack:
    """One power cycle of a vehicle, from truth, sampled evenly.

    `t_s`, `airborne` (n,); `ned_m` (n, 3). `released_s` and `released_ned_m`: the parcel's release,
    at `release_height_m` above the ground there. `margin_wh`: usable energy above the reserve at
    the end.
    """

    vehicle: str
    autopilot: str
    order: str | None
    pad_ne_m: tuple[float, float]
    t_s: np.ndarray
    ned_m: np.ndarray
    airborne: np.ndarray
    energy_used_wh: float
    margin_wh: float
    crashed: bool = False
    released_s: float | None = None
    released_ned_m: tuple[float, float, float] | None = None
    release_height_m: float | None = None
    taken_s: float | None = None
    """When a person took it over; None: nobody did."""


@dataclass(frozen=True, slots=True)
class Stand:
    """The truck stood at a stop from `arrived_s` to `left_s` (infinite: still there)."""

    stop: str
    ne_m: tuple[float, float]
    arrived_s: float
    left_s: float


@dataclass(frozen=True, slots=True)
class Told:
    """From `t_s` on the vehicle reported this home (None: none, or in standby)."""

    t_s: float
    vehicle: str
    home: str | None


@dataclass(frozen=True, slots=True)
class HandedOver:
    """An order that the driver handed over."""

    order: str
    t_s: float


@dataclass(frozen=True, slots=True)
class Pad:
    """A vehicle's landing pad at a stop."""

    stop: str
    vehicle: str
    ne_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class DayFacts:
    """What a day is judged by. `customers`: NED of the ground; `rally`: declared rally points."""

    customers: dict[str, tuple[float, float, float]]
    drop_height_m: float
    tracks: list[VehicleTrack]
    stands: list[Stand]
    pads: list[Pad]
    homes: list[Told]
    served: list[HandedOver]
    rally: list[tuple[float, float]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class DayFlight:
    """One flight, from truth. `stop`: where it landed, `rally`, or None if at no promised place."""

    vehicle: str
    autopilot: str
    order: str | None
    launch_s: float
    land_s: float | None
    outcome: str
    delivered: bool
    home: bool
    stop: str | None
    energy_used_wh: float
    margin_wh: float
    taken: bool = False
    """A person took it over and brought it down: where, is that person's choice."""

    @property
    def accounted_for(self) -> bool:
        """At home, or down whole where a person wanted it."""
        return self.home or (self.taken and self.land_s is not None)


@dataclass(frozen=True, slots=True)
class Near:
    """Closest approach of two airborne vehicles: 3-D distance and its parts, horizontal and
    vertical.
    """

    distance_m: float
    horizontal_m: float
    vertical_m: float
    t_s: float
    vehicles: tuple[str, str]


@dataclass(frozen=True, slots=True)
class DayVerdict:
    """`delivered`: who delivered each order. `lost`: flights that did not end at home, nor whole
    where a person who took over wanted it. `twice`:
    orders flown or handed over again after delivery. `broken`: promises that the truck broke, in
    words.
    """

    flights: list[DayFlight]
    delivered: dict[str, str]
    lost: list[str]
    twice: list[str]
    broken: list[str]
    nearest: Near | None
    nearest_horizontal_m: float | None


def judge_day(world: DayFacts) -> DayVerdict:
    """Judge a finished or interrupted day by truth."""
    flights: list[DayFlight] = []
    broken: list[str] = []
    for track in world.tracks:
        for begin, end in flown(track):
            flights.append(_flight(world, track, begin, end))
            broken += broken_promises(track, begin, end, world)
    flights.sort(key=lambda f: (f.launch_s, f.vehicle))
    lost = [f"{f.vehicle} with {f.order}" for f in flights if not f.accounted_for]
    nearest, horizontal_m = nearest_of(world.tracks)
    by = {f.order: f.vehicle for f in flights if f.delivered and f.order is not None}
    by = {s.order: "truck" for s in world.served} | by
    return DayVerdict(
        flights, by, lost, twice(flights, world.served), broken, nearest, horizontal_m
    )


def flown(track: VehicleTrack) -> list[tuple[int, int]]:
    """First and last airborne sample of each flight within one power cycle."""
    up = np.concatenate(([False], track.airborne > 0.0, [False]))
    edges = np.flatnonzero(np.diff(up.astype(int)))
    spans = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in spans if track.t_s[b] - track.t_s[a] >= LEAST_FLIGHT_S]


def _flight(world: DayFacts, track: VehicleTrack, begin: int, end: int) -> DayFlight:
    landed = end + 1 < len(track.t_s) and not track.crashed
    down = track.ned_m[min(end + 1, len(track.t_s) - 1)]
    ne_m = (float(down[0]), float(down[1]))
    land_s = float(track.t_s[end]) if landed else None
    stop = None if land_s is None else place_of_landing(world, track, ne_m, land_s)
    delivered = brought(world, track, float(track.t_s[begin]), float(track.t_s[end]))
    home = stop is not None and track.margin_wh >= 0.0
    taken = track.taken_s is not None and bool(track.t_s[begin] <= track.taken_s <= track.t_s[end])
    return DayFlight(
        vehicle=track.vehicle,
        autopilot=track.autopilot,
        order=track.order,
        launch_s=float(track.t_s[begin]),
        land_s=land_s,
        outcome=outcome_of(delivered=delivered, home=home, landed_by_person=taken and landed),
        delivered=delivered,
        home=home,
        stop=stop,
        energy_used_wh=track.energy_used_wh,
        margin_wh=track.margin_wh,
        taken=taken,
    )


def brought(world: DayFacts, track: VehicleTrack, begin_s: float, end_s: float) -> bool:
    """Whether the parcel was released on this flight, low over its own customer."""
    place = world.customers.get(track.order or "")
    if place is None or track.released_s is None or track.released_ned_m is None:
        return False
    height_m = track.release_height_m
    return (
        begin_s <= track.released_s <= end_s
        and math.dist(track.released_ned_m[:2], place[:2]) <= DROP_RADIUS_M
        and height_m is not None
        and height_m <= world.drop_height_m + DROP_HEIGHT_SLACK_M
    )


def place_of_landing(
    world: DayFacts, track: VehicleTrack, ne_m: tuple[float, float], land_s: float
) -> str | None:
    """The stop whose pad it landed on, if the truck is or will be there; `rally`; or None."""
    if any(_near(ne_m, place) for place in world.rally):
        return "rally"
    on = {p.stop for p in world.pads if p.vehicle == track.vehicle and _near(ne_m, p.ne_m)}
    for stand in world.stands:
        if stand.stop in on and stand.left_s > land_s:
            return stand.stop
    return None


def _near(ne_m: tuple[float, float], place_ne_m: tuple[float, float]) -> bool:
    return math.dist(ne_m, place_ne_m) <= HOME_RADIUS_M


def broken_promises(track: VehicleTrack, begin: int, end: int, world: DayFacts) -> list[str]:
    """Cases in which the truck left a stop while a flight reported that stop as its home, in
    words.
    """
    begin_s, end_s = float(track.t_s[begin]), float(track.t_s[end])
    told = [(t.t_s, t.home) for t in world.homes if t.vehicle == track.vehicle]
    found: list[str] = []
    for stand in world.stands:
        if not begin_s < stand.left_s <= end_s:
            continue
        before = [home for t_s, home in told if t_s <= stand.left_s]
        again = any(s.stop == stand.stop and s.arrived_s > stand.left_s for s in world.stands)
        if before and before[-1] == stand.stop and not again:
            found.append(
                f"{track.vehicle} with {track.order}: the truck left {stand.stop} at"
                f" {stand.left_s:.0f} s, {end_s - stand.left_s:.0f} s before it was down there"
            )
    return found


def twice(flights: list[DayFlight], served: list[HandedOver]) -> list[str]:
    """Orders that were flown or handed over again after delivery."""
    brought_s: dict[str, float] = {}
    found: list[str] = []
    deeds = [(f.launch_s, f.order, f.delivered, f.land_s or f.launch_s) for f in flights]
    deeds += [(s.t_s, s.order, True, s.t_s) for s in served]
    for begun_s, order, delivered, _ in sorted(deeds, key=lambda d: d[0]):
        if order is None:
            continue
        if order in brought_s:
            found.append(order)
        elif delivered:
            brought_s[order] = begun_s
    return sorted(set(found))


def nearest_of(tracks: list[VehicleTrack]) -> tuple[Near | None, float | None]:
    """Closest approach of any two airborne vehicles, and the least horizontal distance of any two.

    None if no two were airborne at once.
    """
    nears: list[Near] = []
    flat: list[float] = []
    for a, b in itertools.combinations(tracks, 2):
        if a.vehicle != b.vehicle:
            found = _nearest_pair(a, b)
            if found is not None:
                nears.append(found[0])
                flat.append(found[1])
    if not nears:
        return None, None
    return min(nears, key=lambda n: n.distance_m), min(flat)


def _nearest_pair(a: VehicleTrack, b: VehicleTrack) -> tuple[Near, float] | None:
    """Closest approach on the samples of `a`, with `b` interpolated; motion is linear in
    between.
    """
    low = max(a.t_s[0], b.t_s[0])
    high = min(a.t_s[-1], b.t_s[-1])
    times = a.t_s[(a.t_s >= low) & (a.t_s <= high)]
    if times.size < 2:
        return None
    both = (_at(a, times)[1] > 0.0) & (_at(b, times)[1] > 0.0)
    apart = _at(a, times)[0] - _at(b, times)[0]
    inside = both[:-1] & both[1:]
    if not inside.any():
        return None
    start, step = apart[:-1][inside], np.diff(apart, axis=0)[inside]
    squared = np.maximum(np.sum(step * step, axis=1), 1e-12)
    share = np.clip(-np.sum(start * step, axis=1) / squared, 0.0, 1.0)
    closest = start + share[:, None] * step
    distance = np.linalg.norm(closest, axis=1)
    k = int(np.argmin(distance))
    near = Near(
        distance_m=float(distance[k]),
        horizontal_m=float(np.hypot(closest[k][0], closest[k][1])),
        vertical_m=float(abs(closest[k][2])),
        t_s=float(times[:-1][inside][k]),
        vehicles=(a.vehicle, b.vehicle),
    )
    return near, float(np.min(np.hypot(closest[:, 0], closest[:, 1])))


def _at(track: VehicleTrack, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) at these times, and whether it was airborne at the last sample before
    each.
    """
    ned = np.column_stack([np.interp(times, track.t_s, track.ned_m[:, k]) for k in range(3)])
    index = np.clip(np.searchsorted(track.t_s, times + 1e-9) - 1, 0, len(track.t_s) - 1)
    return ned, track.airborne[index]
