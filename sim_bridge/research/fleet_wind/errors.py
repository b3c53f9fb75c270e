"""Wind errors with own data only and with the data of the whole fleet.

Both cases use the same model. Evaluated are the current wind (10 s mean), its mean over a lead
time, and the 10 s mean at the end of that time: at a drone's own position, and at positions without
a drone. In ordinary wind the evaluation is repeated with one drone that reports false data, is
frozen or silent; forecasts of that drone are then excluded from both cases. If all drones report
correctly, the fleet includes the fronts that its front watch reports, false alerts included. At its
own position a drone uses the fleet as in flight: not while it contradicts the drone's own wind.
"""

import math
from dataclasses import astuple, dataclass, replace
from enum import Enum

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field.field_estimator import FieldEstimator
from companion.core.wind_field.field_process import FieldPoints
from companion.core.wind_field.fleet_wind import CONTRADICTION_SQUARE
from companion.core.wind_field.settled_field import FieldEstimate
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, MemberWindReport
from sim_bridge.research.fleet_wind.fields import HEIGHT_M, SITE_M, FleetWorld
from sim_bridge.research.fleet_wind.fronts import KnownFronts, latest_front

OWN_POSITION, FREE_POSITION = "own place", "where nobody is"
POSITION_KINDS = (OWN_POSITION, FREE_POSITION)
BEGIN_S, EVALUATION_INTERVAL_S = 600, 120
TARGETS = 6
MIN_SEPARATION_M = 200.0
"""Minimum distance of a free position from every drone."""
STEP_S = REPORT_AVERAGING_S
"""Time step for forecast means."""
FALSE_OFFSET_NE_MPS = (5.0, 3.0)


class FleetComposition(Enum):
    """Fleet composition: all members correct, or one member faulty from ten minutes on."""

    ALL_CORRECT = "all honest"
    FALSE_DATA = "one lies"
    FROZEN = "one is frozen"
    MUTE = "one is mute"


ALL_CORRECT_ONLY = (FleetComposition.ALL_CORRECT,)


@dataclass(frozen=True, slots=True)
class ForecastQuantity:
    """Forecast quantity: mean over the next `lead_s`, or the 10 s mean at its end."""

    lead_s: float
    is_mean: bool

    @property
    def averaged_s(self) -> float:
        """Averaging time of the evaluated wind."""
        return self.lead_s if self.is_mean else REPORT_AVERAGING_S

    def averaging_span_s(self, now_s: float) -> tuple[float, float]:
        """Return begin and end of the evaluated wind."""
        end_s = now_s + self.lead_s
        if self.is_mean:
            return now_s, end_s
        return end_s - 0.5 * REPORT_AVERAGING_S, end_s + 0.5 * REPORT_AVERAGING_S


FORECAST_QUANTITIES = (
    ForecastQuantity(0.0, False),
    ForecastQuantity(60.0, True),
    ForecastQuantity(150.0, True),
    ForecastQuantity(300.0, True),
    ForecastQuantity(300.0, False),
)
LONGEST_S = max(one.lead_s for one in FORECAST_QUANTITIES)


@dataclass(frozen=True, slots=True)
class SquareSums:
    """Sums over evaluated winds: count, squared error (both axes), squared error over variance."""

    count: int = 0
    own_m2ps2: float = 0.0
    fleet_m2ps2: float = 0.0
    own_nees: float = 0.0
    fleet_nees: float = 0.0

    def __add__(self, other: "SquareSums") -> "SquareSums":
        return SquareSums(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def own_rmse_mps(self) -> float:
        """RMS error per component, own data only."""
        return math.sqrt(self.own_m2ps2 / (2.0 * self.count))

    @property
    def fleet_rmse_mps(self) -> float:
        """RMS error per component, fleet data."""
        return math.sqrt(self.fleet_m2ps2 / (2.0 * self.count))


ErrorSums = dict[str, SquareSums]
"""Sums by the key from `error_sums_key`."""


def error_sums_key(
    composition: FleetComposition, position_kind: str, quantity: ForecastQuantity
) -> str:
    """Return the key of a row of the sums."""
    averaging_kind = "mean" if quantity.is_mean else "instant"
    return f"{composition.value}/{position_kind}/{quantity.lead_s:g}/{averaging_kind}"


def merge_error_sums(parts: list[ErrorSums]) -> ErrorSums:
    """Add sums with equal keys."""
    found: ErrorSums = {}
    for part in parts:
        for key, more in part.items():
            found[key] = found.get(key, SquareSums()) + more
    return found


def simulate_and_sum_wind_errors(
    world: FleetWorld,
    rng: np.random.Generator,
    compositions: tuple[FleetComposition, ...],
    fronts: KnownFronts,
) -> ErrorSums:
    """Return the error sums over all evaluated winds of one world."""
    drones = range(len(world.drones))
    fleets = {kind: FieldEstimator(world.process) for kind in compositions}
    own_estimators = [FieldEstimator(world.process) for _ in drones]
    sums: ErrorSums = {}
    frozen_at: MemberWindReport | None = None
    for index, report_s in enumerate(world.report_times_s):
        now_s = float(report_s)
        wind_reports = [world.wind_report(number, index) for number in drones]
        if now_s <= BEGIN_S:
            frozen_at = wind_reports[0]
        for estimator, wind_report in zip(own_estimators, wind_reports, strict=True):
            estimator.add_report_or_rejection_reason(wind_report, now_s)
        for kind, fleet in fleets.items():
            for wind_report in _reports_with_faulty_first_member(
                wind_reports, kind, frozen_at, now_s
            ):
                fleet.add_report_or_rejection_reason(wind_report, now_s)
        late = now_s + LONGEST_S + REPORT_AVERAGING_S > world.seconds
        if now_s < BEGIN_S or (now_s - BEGIN_S) % EVALUATION_INTERVAL_S or late:
            continue
        own = [estimator.prune_learn_and_estimate_field(now_s) for estimator in own_estimators]
        if FleetComposition.ALL_CORRECT in fleets:
            fleets[FleetComposition.ALL_CORRECT].set_front(latest_front(fronts, now_s))
        settled = {
            kind: fleet.prune_learn_and_estimate_field(now_s) for kind, fleet in fleets.items()
        }
        here = np.stack([patrol.positions_ne_m_at(np.array([now_s]))[0] for patrol in world.drones])
        for number in drones:
            member = {number: own[number]}
            _add_errors_at_position(sums, world, OWN_POSITION, here[number], member, settled)
        for position in _draw_free_positions(here, rng):
            members = dict(enumerate(own))
            _add_errors_at_position(sums, world, FREE_POSITION, position, members, settled)
    return sums


def _add_errors_at_position(
    sums: ErrorSums,
    world: FleetWorld,
    where: str,
    position_ne_m: Floats,
    own_by_member: dict[int, FieldEstimate],
    fleet_by_composition: dict[FleetComposition, FieldEstimate],
) -> None:
    """Add the errors of members that forecast from own data, and of the fleet for each of them.

    At its own position, a member's wind applies if the fleet contradicts it.
    """
    now_s = next(iter(own_by_member.values())).now_s
    actual = np.stack(
        [
            world.true_mean_wind_ne_mps(position_ne_m, *each.averaging_span_s(now_s))
            for each in FORECAST_QUANTITIES
        ]
    )
    own_squares = {
        k: _squared_error_and_nees(own, position_ne_m, actual) for k, own in own_by_member.items()
    }
    for composition, fleet in fleet_by_composition.items():
        correct = [k for k in own_squares if composition is FleetComposition.ALL_CORRECT or k > 0]
        if not correct:
            continue
        own_only = np.sum([own_squares[k] for k in correct], axis=0)
        squares = own_only
        if where == FREE_POSITION or not _fleet_contradicts_member_wind(
            fleet, world.drones[correct[0]].name
        ):
            squares = len(correct) * _squared_error_and_nees(fleet, position_ne_m, actual)
        for q, quantity in enumerate(FORECAST_QUANTITIES):
            key = error_sums_key(composition, where, quantity)
            both = (float(x[q, k]) for k in (0, 1) for x in (own_only, squares))
            sums[key] = sums.get(key, SquareSums()) + SquareSums(len(correct), *both)


def _reports_with_faulty_first_member(
    wind_reports: list[MemberWindReport],
    composition: FleetComposition,
    frozen_at: MemberWindReport | None,
    now_s: float,
) -> list[MemberWindReport]:
    """Return the reports that the fleet receives; the first drone is the faulty one."""
    if composition is FleetComposition.ALL_CORRECT or now_s <= BEGIN_S:
        return wind_reports
    first, others = wind_reports[0], wind_reports[1:]
    if composition is FleetComposition.FALSE_DATA:
        north, east = first.mean_to_ne_mps
        false_wind = north + FALSE_OFFSET_NE_MPS[0], east + FALSE_OFFSET_NE_MPS[1]
        return [replace(first, mean_to_ne_mps=false_wind), *others]
    if composition is FleetComposition.FROZEN and frozen_at is not None:
        return [replace(first, mean_to_ne_mps=frozen_at.mean_to_ne_mps), *others]
    return others


def _draw_free_positions(occupied_ne_m: Floats, rng: np.random.Generator) -> list[Floats]:
    found: list[Floats] = []
    for _ in range(20 * TARGETS):
        position = rng.uniform(-SITE_M, SITE_M, 2)
        if np.hypot(*(occupied_ne_m - position).T).min() >= MIN_SEPARATION_M:
            found.append(position)
        if len(found) == TARGETS:
            break
    return found


def _fleet_contradicts_member_wind(fleet: FieldEstimate, member: str) -> bool:
    """Return True if fleet wind contradicts the member's own, which then applies (`FleetWind`)."""
    square = fleet.chi_square_of_member_against_others(member)
    return square is None or square > CONTRADICTION_SQUARE


def _squared_error_and_nees(field: FieldEstimate, position_ne_m: Floats, actual: Floats) -> Floats:
    """Return squared error and NEES of each forecast quantity at a position, (quantities, 2)."""
    steps = np.arange(0.5 * STEP_S, LONGEST_S, STEP_S)
    single = [q.lead_s for q in FORECAST_QUANTITIES if not q.is_mean]
    t_s = field.now_s + np.concatenate([steps, single])
    points = FieldPoints(np.tile(position_ne_m, (t_s.size, 1)), np.full(t_s.size, HEIGHT_M), t_s)
    forecast = field.forecast_at_points(points, STEP_S)
    found = np.empty((len(FORECAST_QUANTITIES), 2))
    for q, quantity in enumerate(FORECAST_QUANTITIES):
        if quantity.is_mean:
            some = np.flatnonzero(steps < quantity.lead_s)
        else:
            some = np.array([steps.size + single.index(quantity.lead_s)])
        block = np.ix_(some, some)
        variance = np.array(
            [forecast.north_cov_m2ps2[block].mean(), forecast.east_cov_m2ps2[block].mean()]
        )
        error = (actual[q] - forecast.mean_to_ne_mps[some].mean(axis=0)) ** 2
        found[q] = error.sum(), (error / variance).sum()
    return found
