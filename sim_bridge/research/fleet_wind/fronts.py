"""Front alerts: share of drones warned, warning lead time, and false alert rate.

The same field is evaluated with and without a front; without one, every alert is false. Wind is
reported once a second as 10 s means with an error correlation time of about 10 s. Near obstacles,
front arrival is defined by the change of the undisturbed wind, since a lee reduces the change.
"""

import math
from dataclasses import astuple, dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field.field_estimator import LEARNING_INTERVAL_S, FieldEstimator
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.fronts import FrontMonitor, FrontUpdate, FrontWithdrawn, WindFront
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, MemberWindReport
from sim_bridge.research.fleet_wind.fields import HEIGHT_M, REPORT_STD_MPS, DrawnField
from sim_bridge.truth.fields.front import LinearFront

ARRIVAL_CHANGE_MPS = 3.0
"""Change of the 10 s mean wind by a front that defines its arrival at a drone."""
MATCH_S = 300.0
"""Maximum time between an alert and the first arrival of the front it is matched to."""

KnownFronts = tuple[tuple[float, WindFront | None], ...]
"""Fronts with their report times; None: the last one is withdrawn."""


@dataclass(frozen=True, slots=True)
class AlertStatistics:
    """Alert statistics over the fronts of several worlds; tuples hold one entry per event."""

    fronts: int = 0
    reported: int = 0
    drones_to_warn: int = 0
    drones_warned: int = 0
    delays_s: tuple[float, ...] = ()
    """From first arrival at a drone to the alert; negative: alert before a change of 3 m/s."""
    lead_times_s: tuple[float, ...] = ()
    """From the alert to the front's arrival, for each warned drone."""
    false_alerts: int = 0
    hours: float = 0.0
    """Fleet hours in wind without fronts, over which false alerts are counted."""

    def __add__(self, other: "AlertStatistics") -> "AlertStatistics":
        return AlertStatistics(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


@dataclass(frozen=True, slots=True)
class WindReports:
    """Wind reports of each drone at each whole second from 10 s on: (drones, seconds, 2)."""

    t_s: Floats
    positions_ne_m: Floats
    winds_ne_mps: Floats


def draw_mean_wind_reports(
    drawn: DrawnField, rng: np.random.Generator, *, with_front: bool
) -> WindReports:
    """Return 10 s means of the true wind on each drone's path, with errors of equal duration."""
    truth, drones = drawn.true_wind(with_front=with_front), drawn.patrol_list
    span = int(REPORT_AVERAGING_S)
    seconds: Floats = np.arange(drawn.seconds, dtype=np.float64) + 0.5
    t_s = seconds[span - 1 :] + 0.5
    positions_ne_m = np.stack([patrol.positions_ne_m_at(t_s) for patrol in drones])
    winds = np.empty((len(drones), t_s.size, 2))
    for number, patrol in enumerate(drones):
        north, east = patrol.positions_ne_m_at(seconds).T
        each = truth.to_ne_mps(seconds, north, east, HEIGHT_M)
        sums = np.cumsum(np.vstack([np.zeros((1, 2)), each]), axis=0)
        winds[number] = (sums[span:] - sums[:-span]) / span
    return WindReports(t_s, positions_ne_m, winds + _draw_correlated_errors(winds.shape, rng))


def _draw_correlated_errors(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Return errors of the stated standard deviation that are independent after 10 s."""
    drones, seconds, axes = shape
    span = int(REPORT_AVERAGING_S)
    independent = rng.standard_normal((drones, seconds // span + 2, axes))
    at = np.arange(seconds) / span
    low = at.astype(int)
    share = (at - low)[None, :, None]
    mixed = (1.0 - share) * independent[:, low] + share * independent[:, low + 1]
    return REPORT_STD_MPS * mixed / np.sqrt(share**2 + (1.0 - share) ** 2)


def detect_front_updates(wind_reports: WindReports, drawn: DrawnField) -> list[FrontUpdate]:
    """Return new, refined and withdrawn fronts, in chronological order.

    As reported by a desk's front watch, which learns terrain effects from its wind field.
    """
    found: list[FrontUpdate] = []
    process, names = drawn.case.process, [patrol.name for patrol in drawn.patrol_list]
    watch, field = FrontMonitor(process), FieldEstimator(FieldProcess(process))
    settled_s = -math.inf
    variance = REPORT_STD_MPS**2
    for k, t_s in enumerate(wind_reports.t_s.tolist()):
        positions = wind_reports.positions_ne_m[:, k].tolist()
        winds = wind_reports.winds_ne_mps[:, k].tolist()
        for name, (north, east), (to_north, to_east) in zip(names, positions, winds, strict=True):
            now = MemberWindReport(
                name, t_s, (north, east), HEIGHT_M, (to_north, to_east), (variance, 0.0, variance)
            )
            field.add_report_or_rejection_reason(now, t_s)
            front = watch.add_report_and_update_front(now)
            if front is not None:
                found.append(front)
        if t_s - settled_s >= LEARNING_INTERVAL_S:
            settled_s = t_s
            field.prune_learn_and_estimate_field(settled_s)
            watch.set_terrain_share(field.terrain_share)
    return found


def simulate_detected_fronts(
    drawn: DrawnField, rng: np.random.Generator, *, with_front: bool
) -> KnownFronts:
    """Return the fronts that the fleet's watch derives from 1 Hz reports, false alerts included."""
    updates = detect_front_updates(draw_mean_wind_reports(drawn, rng, with_front=with_front), drawn)
    return tuple(front_update_time_and_front(one) for one in updates)


def front_update_time_and_front(front_update: FrontUpdate) -> tuple[float, WindFront | None]:
    """Return the time of a front report, and the front; None: withdrawn."""
    if isinstance(front_update, FrontWithdrawn):
        return front_update.t_s, None
    return max(front_update.detected_s, *(one.t_s for one in front_update.detections)), front_update


def latest_front(known_fronts_by_time: KnownFronts, now_s: float) -> WindFront | None:
    """Return the latest state of the front known at `now_s`."""
    so_far = [front for known_s, front in known_fronts_by_time if known_s <= now_s]
    return so_far[-1] if so_far else None


def first_detection_of_each_front(front_updates: list[FrontUpdate]) -> list[WindFront]:
    """Return new fronts in chronological order, without later refinements."""
    found: dict[float, WindFront] = {}
    for one in front_updates:
        if not isinstance(one, FrontWithdrawn):
            found.setdefault(one.detected_s, one)
    return list(found.values())


def front_arrival_time_s_by_drone(front: LinearFront, wind_reports: WindReports) -> Floats:
    """Return the arrival time of a front (10 s mean) at each drone (inf: never), (drones,)."""
    span = int(REPORT_AVERAGING_S)
    found = np.full(wind_reports.positions_ne_m.shape[0], math.inf)
    for number, position_ne_m in enumerate(wind_reports.positions_ne_m):
        share = np.hypot(
            *front.added_wind_to_ne_mps(
                wind_reports.t_s, position_ne_m[:, 0], position_ne_m[:, 1]
            ).T
        )
        mean = np.convolve(share, np.ones(span) / span)[: share.size]
        arrivals = np.flatnonzero(mean >= ARRIVAL_CHANGE_MPS)
        if arrivals.size:
            found[number] = wind_reports.t_s[arrivals[0]]
    return found


def evaluate_front_alerts(
    front: LinearFront, wind_reports: WindReports, detected_fronts: list[WindFront]
) -> AlertStatistics:
    """Evaluate the alerts of a world with one front."""
    arrivals = front_arrival_time_s_by_drone(front, wind_reports)
    first_s = float(arrivals.min())
    if not math.isfinite(first_s):
        return AlertStatistics()
    others = arrivals[np.isfinite(arrivals) & (arrivals > first_s)]
    near = [one for one in detected_fronts if abs(one.detected_s - first_s) <= MATCH_S]
    if not near:
        return AlertStatistics(fronts=1, drones_to_warn=others.size)
    alert_s = near[0].detected_s
    lead_times_s = tuple((others[others > alert_s] - alert_s).tolist())
    return AlertStatistics(1, 1, others.size, len(lead_times_s), (alert_s - first_s,), lead_times_s)
