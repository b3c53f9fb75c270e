"""How much better the wind is known when all tell: own data only against everybody's.

The same model both times. Judged are the wind now (a 10 s mean), its mean over some time to come,
and a single 10 s mean at the end of it: at a drone's own place, and at places where nobody is. In
ordinary wind the fleet is judged again with one drone that lies, is frozen or mute; that one's own
forecasts are then left out on both sides. Where all are honest the fleet knows the fronts that its
watch tells, false ones as well; who is alone has nobody who would tell. At its own place a drone
uses the fleet as it does aboard: not while it contradicts its own wind.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field.field_belief import FieldBelief
from companion.core.wind_field.field_process import FieldPoints
from companion.core.wind_field.fleet_wind import DOUBT_SQUARE
from companion.core.wind_field.settled_field import SettledField
from companion.core.wind_field.tellings import TELLING_S, WindTelling
from sim_bridge.research.fleet_wind.front_stages import NO_FRONTS, FrontsOfWorld, FrontStage
from sim_bridge.research.fleet_wind.patrols import HEIGHT_M, SITE_M
from sim_bridge.research.fleet_wind.worlds import FleetWorld

OWN_PLACE, NOBODY = "own place", "where nobody is"
PLACES = (OWN_PLACE, NOBODY)
BEGIN_S, EVERY_S = 600, 120
TARGETS = 6
APART_M = 200.0
"""From every drone: less is somebody's own place."""
STEP_S = TELLING_S
"""Means to come are taken over steps of this."""
LIE_NE_MPS = (5.0, 3.0)


class Members(Enum):
    """Who is in the fleet: all honest, or one of them, from ten minutes on, something else."""

    HONEST = "all honest"
    LYING = "one lies"
    FROZEN = "one is frozen"
    MUTE = "one is mute"


@dataclass(frozen=True, slots=True)
class Question:
    """A mean over the next `lead_s`, or the 10 s mean at its end."""

    lead_s: float
    is_mean: bool

    @property
    def averaged_s(self) -> float:
        """Over how long the wind is averaged that is judged."""
        return self.lead_s if self.is_mean else TELLING_S


QUESTIONS = (
    Question(0.0, False),
    Question(60.0, True),
    Question(150.0, True),
    Question(300.0, True),
    Question(300.0, False),
)
LONGEST_S = max(one.lead_s for one in QUESTIONS)


@dataclass(frozen=True, slots=True)
class SquareSums:
    """Over judged winds: how many, squares of error (both axes), of error over stated variance."""

    count: int = 0
    own_m2ps2: float = 0.0
    fleet_m2ps2: float = 0.0
    own_nees: float = 0.0
    fleet_nees: float = 0.0

    def __add__(self, other: "SquareSums") -> "SquareSums":
        return SquareSums(
            self.count + other.count,
            self.own_m2ps2 + other.own_m2ps2,
            self.fleet_m2ps2 + other.fleet_m2ps2,
            self.own_nees + other.own_nees,
            self.fleet_nees + other.fleet_nees,
        )

    @property
    def own_rmse_mps(self) -> float:
        """By component."""
        return math.sqrt(self.own_m2ps2 / (2.0 * self.count))

    @property
    def fleet_rmse_mps(self) -> float:
        """By component."""
        return math.sqrt(self.fleet_m2ps2 / (2.0 * self.count))


def key_of(
    members: Members, where: str, question: Question, stage: FrontStage = FrontStage.WHOLE
) -> str:
    """Names a row of the sums."""
    what = "mean" if question.is_mean else "instant"
    return f"{members.value}/{where}/{question.lead_s:g}/{what}/{stage.value}"


@dataclass(slots=True)
class ErrorTally:
    """Sums by row, and how often somebody was left out of the fleet's belief."""

    sums: dict[str, SquareSums]
    settled: dict[str, int]
    left_out: dict[str, int]
    """By who is in the fleet: beliefs, and members left out of them."""

    @classmethod
    def empty(cls) -> "ErrorTally":
        """Nothing judged yet."""
        return cls({}, {}, {})

    def add(self, key: str, more: SquareSums) -> None:
        """Count in one row."""
        self.sums[key] = self.sums.get(key, SquareSums()) + more

    def joined(self, other: "ErrorTally") -> "ErrorTally":
        """Both."""
        both = ErrorTally(dict(self.sums), dict(self.settled), dict(self.left_out))
        for key, more in other.sums.items():
            both.add(key, more)
        for mine, theirs in ((both.settled, other.settled), (both.left_out, other.left_out)):
            for name, count in theirs.items():
                mine[name] = mine.get(name, 0) + count
        return both


def judge_errors(
    world: FleetWorld,
    rng: np.random.Generator,
    kinds: tuple[Members, ...] = (Members.HONEST,),
    fronts: FrontsOfWorld = NO_FRONTS,
) -> ErrorTally:
    """All judged winds of one world."""
    drones = len(world.drones)
    fleets = {kind: FieldBelief(world.process) for kind in kinds}
    alone = [FieldBelief(world.process) for _ in range(drones)]
    tally = ErrorTally.empty()
    frozen_at: WindTelling | None = None
    for index, told_s in enumerate(world.told_s):
        now_s = float(told_s)
        tellings = [world.telling(number, index) for number in range(drones)]
        if now_s <= BEGIN_S:
            frozen_at = tellings[0]
        for number, telling in enumerate(tellings):
            alone[number].tell(telling, now_s)
        for kind, fleet in fleets.items():
            for telling in _as_told(tellings, kind, frozen_at, now_s):
                fleet.tell(telling, now_s)
        late = now_s + LONGEST_S + TELLING_S > world.seconds
        if now_s < BEGIN_S or (now_s - BEGIN_S) % EVERY_S or late:
            continue
        here = np.stack([way.at(np.array([now_s]))[0] for way in world.drones])
        own = [belief.settle(now_s) for belief in alone]
        judged = [_Judged.of(world, fronts, OWN_PLACE, here[k], own, (k,)) for k in range(drones)]
        everybody = tuple(range(drones))
        free = _free_places(here, rng)
        judged += [_Judged.of(world, fronts, NOBODY, place, own, everybody) for place in free]
        if Members.HONEST in fleets:
            fleets[Members.HONEST].expect_front(fronts.newest(now_s))
        for kind, fleet in fleets.items():
            settled = fleet.settle(now_s)
            tally.settled[kind.value] = tally.settled.get(kind.value, 0) + 1
            tally.left_out[kind.value] = tally.left_out.get(kind.value, 0) + len(settled.left_out)
            for one in judged:
                one.add_to(tally, kind, settled)
    return tally


def _as_told(
    tellings: list[WindTelling], kind: Members, frozen_at: WindTelling | None, now_s: float
) -> list[WindTelling]:
    """What the fleet is told: the first drone is the bad one."""
    if kind is Members.HONEST or now_s <= BEGIN_S:
        return tellings
    first, others = tellings[0], tellings[1:]
    if kind is Members.LYING:
        north, east = first.mean_to_ne_mps
        lie = north + LIE_NE_MPS[0], east + LIE_NE_MPS[1]
        return [replace(first, mean_to_ne_mps=lie), *others]
    if kind is Members.FROZEN and frozen_at is not None:
        return [replace(first, mean_to_ne_mps=frozen_at.mean_to_ne_mps), *others]
    return others


def _free_places(taken: Floats, rng: np.random.Generator) -> list[Floats]:
    found: list[Floats] = []
    for _ in range(20 * TARGETS):
        place = rng.uniform(-SITE_M, SITE_M, 2)
        if np.hypot(*(taken - place).T).min() >= APART_M:
            found.append(place)
        if len(found) == TARGETS:
            break
    return found


@dataclass(frozen=True, slots=True)
class _Judged:
    """One place: its true winds, and the error and NEES there of who forecasts alone.

    `actual` (questions, 2), `stages` (questions,) of a front, `alone` by member (questions, 2).
    """

    where: str
    place_ne_m: Floats
    actual: Floats
    stages: tuple[FrontStage, ...]
    alone: dict[int, Floats]
    names: tuple[str, ...]

    @classmethod
    def of(
        cls,
        world: FleetWorld,
        fronts: FrontsOfWorld,
        where: str,
        place_ne_m: Floats,
        own: list[SettledField],
        who: tuple[int, ...],
    ) -> "_Judged":
        now_s = own[0].now_s
        actual, stages = np.empty((len(QUESTIONS), 2)), list[FrontStage]()
        for q, question in enumerate(QUESTIONS):
            first, last = now_s, now_s + question.lead_s
            if not question.is_mean:
                first, last = last - 0.5 * TELLING_S, last + 0.5 * TELLING_S
            actual[q] = world.mean_truth(place_ne_m, first, last)
            stages.append(fronts.stage(place_ne_m, now_s, last))
        alone = {k: _squares(forecasts(own[k], place_ne_m), actual) for k in who}
        names = tuple(way.name for way in world.drones)
        return cls(where, place_ne_m, actual, tuple(stages), alone, names)

    def add_to(self, tally: ErrorTally, kind: Members, fleet: SettledField) -> None:
        """Count the fleet's error once for each honest member who forecasts alone."""
        honest = [k for k in self.alone if kind is Members.HONEST or k > 0]
        if not honest:
            return
        alone = np.sum([self.alone[k] for k in honest], axis=0)
        if self.where == OWN_PLACE and _contradicts(fleet, self.names[honest[0]]):
            squares = alone
        else:
            squares = _squares(forecasts(fleet, self.place_ne_m), self.actual)
        count = len(honest)
        for q, question in enumerate(QUESTIONS):
            error, nees = (float(x) for x in count * squares[q])
            own_error, own_nees = (float(x) for x in alone[q])
            sums = SquareSums(count, own_error, error, own_nees, nees)
            for stage in (FrontStage.WHOLE, self.stages[q]):
                tally.add(key_of(kind, self.where, question, stage), sums)


def _contradicts(fleet: SettledField, member: str) -> bool:
    """Whether the fleet's wind contradicts a member's own, which it then keeps to (`FleetWind`)."""
    square = fleet.disagreement(member)
    return square is None or square > DOUBT_SQUARE


def _squares(said: tuple[Floats, Floats], actual: Floats) -> Floats:
    """Squared error and NEES of each question, (questions, 2)."""
    mean, variance = said
    error = (actual - mean) ** 2
    return np.stack([error.sum(axis=1), (error / variance).sum(axis=1)], axis=1)


def forecasts(field: SettledField, place_ne_m: Floats) -> tuple[Floats, Floats]:
    """Means and variances of each question's wind at a place, (questions, 2) each."""
    steps = np.arange(0.5 * STEP_S, LONGEST_S, STEP_S)
    single = [q.lead_s for q in QUESTIONS if not q.is_mean]
    ahead_s = np.concatenate([steps, single])
    said = field.forecast(points_at(place_ne_m, field.now_s + ahead_s), STEP_S)
    means, variances = np.empty((len(QUESTIONS), 2)), np.empty((len(QUESTIONS), 2))
    for q, question in enumerate(QUESTIONS):
        if question.is_mean:
            some = np.flatnonzero(steps < question.lead_s)
        else:
            some = np.array([steps.size + single.index(question.lead_s)])
        block = np.ix_(some, some)
        means[q] = said.mean_to_ne_mps[some].mean(axis=0)
        variances[q] = said.north_cov_m2ps2[block].mean(), said.east_cov_m2ps2[block].mean()
    return means, variances


def points_at(place_ne_m: Floats, t_s: Floats) -> FieldPoints:
    """One place at several times, at the drones' height."""
    return FieldPoints(np.tile(place_ne_m, (t_s.size, 1)), np.full(t_s.size, HEIGHT_M), t_s)
