"""Verdict on a day from ground truth: vehicles at home, parcels delivered, minimum separations.

Times are the day's, positions NED metres about its depot. Estimates of desk and companions are not
used, with one exception: the home that each vehicle reported over time. The truck must keep that
promise (safety rule 3).
"""

import itertools
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.app.world.truth_record import LOST_OUTCOMES, TruthRecord, is_within_home_radius

MIN_FLIGHT_S = 5.0
"""Shorter airborne intervals are landing bounces, not flights."""


@dataclass(slots=True)
class VehicleTrack:
    """One power cycle of a vehicle, from truth.

    The samples of the record as arrays: `t_s`, `airborne` (n,); `ned_m` (n, 3).
    """

    vehicle: str
    autopilot: str
    order: str | None
    record: TruthRecord
    reserve_wh: float
    override_time_s: float | None = None
    """Time of the pilot override, or None."""
    t_s: np.ndarray = field(init=False)
    ned_m: np.ndarray = field(init=False)
    airborne: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        samples = self.record.samples_by_column()
        self.t_s, self.airborne = samples["t_s"], samples["airborne"]
        self.ned_m = np.column_stack([samples[name] for name in ("north_m", "east_m", "down_m")])


@dataclass(frozen=True, slots=True)
class ParkedInterval:
    """The truck was parked at a stop from `arrived_s` to `left_s` (infinite: until the end)."""

    stop: str
    ne_m: tuple[float, float]
    arrived_s: float
    left_s: float


@dataclass(frozen=True, slots=True)
class HomeReport:
    """The vehicle reported this home from `t_s` (None: no home, or in standby)."""

    t_s: float
    vehicle: str
    home: str | None


@dataclass(frozen=True, slots=True)
class Handover:
    """An order that the driver delivered in person."""

    order: str
    t_s: float


@dataclass(frozen=True, slots=True)
class Pad:
    """A vehicle's landing pad at a stop."""

    stop: str
    vehicle: str
    ne_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class DayTruth:
    """Inputs of a day's verdict. `customers`: ground position, NED; `rally`: rally points."""

    customers: dict[str, tuple[float, float, float]]
    drop_height_m: float
    tracks: list[VehicleTrack]
    parked_intervals: list[ParkedInterval]
    pads: list[Pad]
    home_reports: list[HomeReport]
    handovers: list[Handover]
    rally: list[tuple[float, float]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class DayFlight:
    """One flight, from truth. `stop`: stop of its landing, `rally`, or None elsewhere."""

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
    """Whether a pilot override occurred."""


@dataclass(frozen=True, slots=True)
class MinimumSeparation:
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
    """Verdict on a day. `delivered`: the vehicle that delivered each order. `lost_flights`: flights
    that ended neither at home nor intact in a pilot's landing. `duplicate_orders`: orders flown
    or handed over again after delivery. `broken_promises`: descriptions of promises that the truck
    broke.
    """

    flights: list[DayFlight]
    delivered: dict[str, str]
    lost_flights: list[str]
    duplicate_orders: list[str]
    broken_promises: list[str]
    minimum_separation: MinimumSeparation | None
    nearest_horizontal_m: float | None


def evaluate_day(truth: DayTruth) -> DayVerdict:
    """Return the verdict on a finished or interrupted day."""
    flights: list[DayFlight] = []
    broken: list[str] = []
    for track in truth.tracks:
        for begin, end in find_flight_sample_ranges(track):
            flights.append(_evaluate_flight(truth, track, begin, end))
            broken += describe_departures_from_reported_home(track, begin, end, truth)
    flights.sort(key=lambda f: (f.launch_s, f.vehicle))
    lost = [f"{f.vehicle} with {f.order}" for f in flights if f.outcome in LOST_OUTCOMES]
    nearest, horizontal_m = find_minimum_3d_and_horizontal_separation(truth.tracks)
    vehicle_by_order = {f.order: f.vehicle for f in flights if f.delivered and f.order is not None}
    vehicle_by_order = {s.order: "truck" for s in truth.handovers} | vehicle_by_order
    return DayVerdict(
        flights,
        vehicle_by_order,
        lost,
        find_orders_repeated_after_delivery(flights, truth.handovers),
        broken,
        nearest,
        horizontal_m,
    )


def find_flight_sample_ranges(track: VehicleTrack) -> list[tuple[int, int]]:
    """Return first and last airborne sample of each flight within one power cycle."""
    up = np.concatenate(([False], track.airborne > 0.0, [False]))
    edges = np.flatnonzero(np.diff(up.astype(int)))
    spans = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in spans if track.t_s[b] - track.t_s[a] >= MIN_FLIGHT_S]


def _evaluate_flight(
    truth: DayTruth, track: VehicleTrack, begin_index: int, end_index: int
) -> DayFlight:
    begin_s, end_s = float(track.t_s[begin_index]), float(track.t_s[end_index])
    record, customer_ned_m = track.record, truth.customers.get(track.order or "")
    next_index = min(end_index + 1, len(track.t_s) - 1)
    landed = next_index > end_index and not record.crashed
    north_m, east_m, _ = track.ned_m[next_index].tolist()
    stop = find_home_stop_of_landing(truth, track, (north_m, east_m), end_s) if landed else None
    outcome = record.evaluate_outcome(
        delivered=customer_ned_m is not None
        and record.is_parcel_released_at(customer_ned_m[:2], truth.drop_height_m, begin_s, end_s),
        landed_s=float(track.t_s[next_index]) if landed else None,
        at_home=stop is not None,
        reserve_wh=track.reserve_wh,
    )
    return DayFlight(
        vehicle=track.vehicle,
        autopilot=track.autopilot,
        order=track.order,
        launch_s=begin_s,
        land_s=end_s if landed else None,
        outcome=outcome.code,
        delivered=outcome.delivered,
        home=outcome.home,
        stop=stop,
        energy_used_wh=outcome.energy_used_wh,
        margin_wh=outcome.margin_wh,
        taken=track.override_time_s is not None and begin_s <= track.override_time_s <= end_s,
    )


def find_home_stop_of_landing(
    truth: DayTruth, track: VehicleTrack, landing_ne_m: tuple[float, float], land_s: float
) -> str | None:
    """Return the stop of the pad it landed on if the truck is or will be there, `rally` or None."""
    if any(is_within_home_radius(landing_ne_m, position_ned_m) for position_ned_m in truth.rally):
        return "rally"
    on = {
        p.stop
        for p in truth.pads
        if p.vehicle == track.vehicle and is_within_home_radius(landing_ne_m, p.ne_m)
    }
    for interval in truth.parked_intervals:
        if interval.stop in on and interval.left_s > land_s:
            return interval.stop
    return None


def describe_departures_from_reported_home(
    track: VehicleTrack, begin_index: int, end_index: int, truth: DayTruth
) -> list[str]:
    """Return descriptions of each departure of the truck from a stop that a flight reported as its
    home.
    """
    begin_s, end_s = float(track.t_s[begin_index]), float(track.t_s[end_index])
    reports = [(t.t_s, t.home) for t in truth.home_reports if t.vehicle == track.vehicle]
    found: list[str] = []
    for interval in truth.parked_intervals:
        if not begin_s < interval.left_s <= end_s:
            continue
        before = [home for t_s, home in reports if t_s <= interval.left_s]
        returns = any(
            s.stop == interval.stop and s.arrived_s > interval.left_s
            for s in truth.parked_intervals
        )
        if before and before[-1] == interval.stop and not returns:
            found.append(
                f"{track.vehicle} with {track.order}: the truck left {interval.stop} at"
                f" {interval.left_s:.0f} s, {end_s - interval.left_s:.0f} s before it was down"
                " there"
            )
    return found


def find_orders_repeated_after_delivery(
    flights: list[DayFlight], handovers: list[Handover]
) -> list[str]:
    """Return orders that were flown or handed over again after delivery."""
    delivered_s: dict[str, float] = {}
    found: list[str] = []
    actions = [(f.launch_s, f.order, f.delivered, f.land_s or f.launch_s) for f in flights]
    actions += [(s.t_s, s.order, True, s.t_s) for s in handovers]
    for begun_s, order, delivered, _ in sorted(actions, key=lambda d: d[0]):
        if order is None:
            continue
        if order in delivered_s:
            found.append(order)
        elif delivered:
            delivered_s[order] = begun_s
    return sorted(set(found))


def find_minimum_3d_and_horizontal_separation(
    tracks: list[VehicleTrack],
) -> tuple[MinimumSeparation | None, float | None]:
    """Return the closest approach of any two airborne vehicles and their least horizontal distance.

    None if no two vehicles were airborne at once.
    """
    nears: list[MinimumSeparation] = []
    flat: list[float] = []
    for a, b in itertools.combinations(tracks, 2):
        if a.vehicle != b.vehicle:
            found = _pair_minimum_3d_and_horizontal_separation(a, b)
            if found is not None:
                nears.append(found[0])
                flat.append(found[1])
    if not nears:
        return None, None
    return min(nears, key=lambda n: n.distance_m), min(flat)


def relative_motion_while_both_airborne(
    first_track: VehicleTrack, second_track: VehicleTrack
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the intervals between samples in which both are airborne; None if there are none.

    Start times (n,), position of the first relative to the second then, and its change (n, 3).
    """
    low = max(first_track.t_s[0], second_track.t_s[0])
    high = min(first_track.t_s[-1], second_track.t_s[-1])
    times = first_track.t_s[(first_track.t_s >= low) & (first_track.t_s <= high)]
    if times.size < 2:
        return None
    first_ned_m, first_airborne = _interpolate_position_and_airborne(first_track, times)
    second_ned_m, second_airborne = _interpolate_position_and_airborne(second_track, times)
    both = (first_airborne > 0.0) & (second_airborne > 0.0)
    separation_ned_m = first_ned_m - second_ned_m
    inside = both[:-1] & both[1:]
    if not inside.any():
        return None
    return (
        times[:-1][inside],
        separation_ned_m[:-1][inside],
        np.diff(separation_ned_m, axis=0)[inside],
    )


def _pair_minimum_3d_and_horizontal_separation(
    first_track: VehicleTrack, second_track: VehicleTrack
) -> tuple[MinimumSeparation, float] | None:
    """Return the closest approach, from the samples of `first_track` and interpolated
    `second_track`, with linear motion between samples.
    """
    motion = relative_motion_while_both_airborne(first_track, second_track)
    if motion is None:
        return None
    times_s, start, step = motion
    squared = np.maximum(np.sum(step * step, axis=1), 1e-12)
    share = np.clip(-np.sum(start * step, axis=1) / squared, 0.0, 1.0)
    closest = start + share[:, None] * step
    distance = np.linalg.norm(closest, axis=1)
    k = int(np.argmin(distance))
    near = MinimumSeparation(
        distance_m=float(distance[k]),
        horizontal_m=float(np.hypot(closest[k][0], closest[k][1])),
        vertical_m=float(abs(closest[k][2])),
        t_s=float(times_s[k]),
        vehicles=(first_track.vehicle, second_track.vehicle),
    )
    return near, float(np.min(np.hypot(closest[:, 0], closest[:, 1])))


def _interpolate_position_and_airborne(
    track: VehicleTrack, times_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 3) at these times, and airborne flags of the last sample before each."""
    ned = np.column_stack([np.interp(times_s, track.t_s, track.ned_m[:, k]) for k in range(3)])
    index = np.clip(np.searchsorted(track.t_s, times_s + 1e-9) - 1, 0, len(track.t_s) - 1)
    return ned, track.airborne[index]
