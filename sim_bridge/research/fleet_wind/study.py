"""The study of `fleet-wind`: draws of fields, each with ordinary wind and with a front."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams
from sim_bridge.research.fleet_wind.alert_study import (
    NO_ALERTS,
    AlertFigures,
    Beliefs,
    alerts_in,
    beliefs,
    front_news,
    judge_front,
)
from sim_bridge.research.fleet_wind.error_study import ErrorTally, Members, judge_errors
from sim_bridge.research.fleet_wind.front_bound import NO_BOUNDS, AlertBounds, judge_bounds
from sim_bridge.research.fleet_wind.front_stages import FrontsOfWorld, fronts_of_world
from sim_bridge.research.fleet_wind.patrols import Patrol, patrols
from sim_bridge.research.fleet_wind.worlds import FleetWorld, fitted, halves_of, world_of
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.coherent_field import Coherence, CoherentField
from sim_bridge.truth.fields.computed_flow import ComputedFlows
from sim_bridge.truth.fields.field_file import (
    WindFieldParams,
    drawn_series,
    flows_of,
    load_wind_field,
)
from sim_bridge.truth.fields.front import PassingFront, drawn_front
from sim_bridge.truth.fields.lees import Obstacle
from sim_bridge.truth.fields.site_wind import SiteWind

FRONT_LEAST_MPS, FRONT_MOST_MPS = 5.0, 10.0
"""Of fronts laid over a recording."""
FRONT_FROM_S, FRONT_UNTIL_S = 900.0, 700.0
"""A front reaches the middle no sooner than this, and no later than this before the end."""
_KEPT_ASIDE = 1_000_000
"""The draw of a made field that the belief's process is fitted to; never judged."""


@dataclass(frozen=True, slots=True)
class FleetWindSetting:
    """Options of a study. With `file`, the digest of its wind, it identifies the run."""

    wind_log: str | None
    field: str | None
    file: str
    drones: int
    hovering: int
    along: float
    across: float
    seed: int


@dataclass(frozen=True, slots=True)
class FieldDraw:
    """One draw: which case of the wind (half of a recording), and what is judged in it."""

    setting: FleetWindSetting
    case: int
    number: int
    errors: bool
    alerts: bool
    bounds: bool = False
    """Alerts are held against those of ideal tests, too."""


@dataclass(frozen=True, slots=True)
class DrawResult:
    """What one draw gave."""

    ordinary: ErrorTally
    front: ErrorTally
    alerts: AlertFigures
    bounds: AlertBounds = NO_BOUNDS


@dataclass(frozen=True, slots=True)
class _Case:
    """A wind to draw about, and the process that is believed of it."""

    series_ne_mps: Floats
    process: WindProcessParams
    params: WindFieldParams | None


def made_field(path: Path) -> WindFieldParams:
    """A made field's file; LeewayError names its mistake."""
    try:
        return load_wind_field(path)
    except TruthError as error:
        raise LeewayError(str(error)) from error


def summed(results: Sequence[DrawResult]) -> DrawResult:
    """All draws as one."""
    ordinary = front = ErrorTally.empty()
    alerts, bounds = NO_ALERTS, NO_BOUNDS
    for one in results:
        ordinary, front = ordinary.joined(one.ordinary), front.joined(one.front)
        alerts += one.alerts
        bounds += one.bounds
    return DrawResult(ordinary, front, alerts, bounds)


def case_names(setting: FleetWindSetting) -> tuple[str, ...]:
    """Winds that are judged: both halves of a recording, or the made field."""
    if setting.wind_log is None:
        return (_made(setting).name,)
    return tuple(half.name for half in halves_of(Path(setting.wind_log)))


def mean_wind_mps(setting: FleetWindSetting) -> float:
    """Mean speed of the wind that is judged."""
    if setting.wind_log is None:
        return _made(setting).mean_mps
    halves = halves_of(Path(setting.wind_log))
    return float(np.mean([np.hypot(*half.wind_ne_mps.T).mean() for half in halves]))


def draws_of(
    setting: FleetWindSetting, errors: int, alerts: int, *, bounds: bool = False
) -> list[FieldDraw]:
    """So many draws of each case: the first `errors` judge errors, the first `alerts` alerts, with
    `bounds` against ideal tests as well.
    """
    cases = range(len(case_names(setting)))
    count = max(errors, alerts)
    return [
        FieldDraw(setting, case, k, k < errors, k < alerts, bounds and k < alerts)
        for k in range(count)
        for case in cases
    ]


@dataclass(frozen=True, slots=True)
class DrawnField:
    """One draw's truth and fleet. `rng` goes on with what is told."""

    field: CoherentField
    process: WindProcessParams
    ways: list[Patrol]
    front: PassingFront
    sizes_mps: tuple[float, float]
    """Between which its change was drawn."""
    rng: np.random.Generator
    obstacles: tuple[Obstacle, ...] = ()
    flows: ComputedFlows | None = None

    def world(self, *, front: bool) -> FleetWorld:
        """What the drones tell in it, with its front or without."""
        return world_of(self.truth(front=front), self.seconds, self.process, self.ways, self.rng)

    def truth(self, *, front: bool) -> SiteWind:
        """The wind with its front or without."""
        fronts = [self.front] if front else []
        return SiteWind(self.field, fronts, obstacles=self.obstacles, flows=self.flows)

    def fronts(self, *, front: bool) -> FrontsOfWorld:
        """What the fleet is told of fronts. Its own randomness: what else is drawn stays."""
        real, rng = self.front if front else None, self.rng.spawn(1)[0]
        truth, ways, seconds = self.truth(front=front), self.ways, float(self.seconds)
        return fronts_of_world(truth, ways, seconds, self.process, real, rng)

    @property
    def seconds(self) -> int:
        """How long it lasts."""
        return self.field.seconds


def drawn_field(setting: FleetWindSetting, case: int, number: int) -> DrawnField:
    """A draw of a case, the same in every process."""
    known = _case(setting, case, number)
    rng = np.random.default_rng([setting.seed, case, number])
    field = CoherentField(known.series_ne_mps, Coherence(setting.along, setting.across), rng)
    ways = patrols(setting.drones, setting.hovering, field.seconds, rng)
    least, most = FRONT_LEAST_MPS, FRONT_MOST_MPS
    obstacles: tuple[Obstacle, ...] = ()
    if known.params is not None:
        least, most = known.params.front_least_mps, known.params.front_most_mps
        obstacles = known.params.obstacles
    t_s = float(rng.uniform(FRONT_FROM_S, field.seconds - FRONT_UNTIL_S))
    front = drawn_front(t_s, field.mean_ne_mps, least, most, rng)
    flows = computed_flows(setting)
    return DrawnField(field, known.process, ways, front, (least, most), rng, obstacles, flows)


def judge_draw(draw: FieldDraw) -> DrawResult:
    """One field: errors in ordinary wind and with a front, alerts with a front and without."""
    drawn = drawn_field(draw.setting, draw.case, draw.number)
    ordinary = with_front = ErrorTally.empty()
    if draw.errors:
        calm, gust = (drawn.fronts(front=front) for front in (False, True))
        ordinary = judge_errors(drawn.world(front=False), drawn.rng, tuple(Members), calm)
        with_front = judge_errors(drawn.world(front=True), drawn.rng, fronts=gust)
    names = [way.name for way in drawn.ways]
    alerts, bounds = NO_ALERTS, NO_BOUNDS
    heard: list[Beliefs] = []
    for front in (False, True) if draw.alerts else ():
        last_s = float(drawn.seconds)
        told = beliefs(drawn.truth(front=front), drawn.ways, 0.0, last_s, drawn.rng)
        heard.append(told)
        found = alerts_in(front_news(told, names, drawn.process))
        if front:
            alerts += judge_front(drawn.front, told, found, drawn.process)
        else:
            hours = float(np.ptp(told.t_s)) / 3600.0
            stood_s = tuple(one.stood_s for one in found if one.stood_s is not None)
            alerts += AlertFigures(false=len(found), hours=hours, false_for_s=stood_s)
    if draw.bounds:
        calm, amid = heard
        coherence = Coherence(draw.setting.along, draw.setting.across)
        bounds = judge_bounds(
            drawn.field, coherence, drawn.ways, drawn.front, drawn.sizes_mps, amid, calm
        )
    return DrawResult(ordinary, with_front, alerts, bounds)


@lru_cache(maxsize=4)
def _case(setting: FleetWindSetting, case: int, number: int) -> _Case:
    if setting.wind_log is not None:
        half = halves_of(Path(setting.wind_log))[case]
        return _Case(half.wind_ne_mps, half.process, None)
    params = _made(setting)
    series = drawn_series(params, np.random.default_rng([setting.seed, 7, number]))
    return _Case(series, _believed(setting), params)


@lru_cache(maxsize=1)
def _believed(setting: FleetWindSetting) -> WindProcessParams:
    params = _made(setting)
    aside = np.random.default_rng([setting.seed, 7, _KEPT_ASIDE])
    return fitted(drawn_series(params, aside))


@lru_cache(maxsize=1)
def _made(setting: FleetWindSetting) -> WindFieldParams:
    assert setting.field is not None
    return made_field(Path(setting.field))


@lru_cache(maxsize=1)
def computed_flows(setting: FleetWindSetting) -> ComputedFlows | None:
    """The flows that the made field's file names, if any; LeewayError names a grid's mistake."""
    if setting.field is None:
        return None
    try:
        return flows_of(_made(setting), Path(setting.field))
    except TruthError as error:
        raise LeewayError(str(error)) from error
