"""Whole flights of the pilot with its own gate, while a desk publishes other vehicles' winds:
correct, false, or none. The vehicle's own wind is scripted.
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import AlertReport, AssessmentReport, Decision
from companion.core.pilot.estimates import FlightEstimates
from companion.core.pilot.transitions import Phase
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.wind.estimator import WindBelief
from companion.core.wind_field.shared_winds import EncodedFront, EncodedWindReport, SharedWinds
from tests.companion.pilot.fake_vehicle import AIRFRAME, DEPOT, FLIGHT, WIND_PROCESS, World, world

FAR = msgspec.structs.replace(
    FLIGHT,
    site=msgspec.structs.replace(
        FLIGHT.site,
        rally=(),
        customer=msgspec.structs.replace(FLIGHT.site.customer, north_m=1400.0),
    ),
    mission=msgspec.structs.replace(FLIGHT.mission, wind_settle_s=25.0),
)
AT = {"d2": (400, 100), "d3": (-500, 300), "d4": (200, -600)}
REJUDGED_S = 10.0


class ScriptedWind:
    """A wind filter that estimates a light wind to the east, with gusts."""

    def __init__(self) -> None:
        self.gusts = np.random.default_rng(5).normal(0.0, 0.4, (3000, 2))

    def detections(self, t_s: float) -> Any:
        return np.array([0.5, 3.0]) + self.gusts[int(t_s)]

    def update(self, observation: Any) -> tuple[str, ...]:
        return ()

    def belief(self, t_s: float) -> WindBelief:
        return WindBelief(t_s, self.detections(t_s), 0.25 * np.eye(2), ("tilt",), True)

    def snapshot(self) -> dict[str, object]:
        return {}

    def restore(self, snapshot: dict[str, object]) -> None:
        return


Tells = Callable[[float, str, Any], "tuple[float, float] | None"]


def word(t_s: float, tells: Tells, front: Any = msgspec.UNSET) -> SharedWinds:
    """Return the winds of other members: each has its own gusts, as modified by `tells`."""
    told = []
    for number, (name, place) in enumerate(AT.items()):
        gust = np.random.default_rng([int(t_s), number]).normal(0.0, 0.4, 2)
        wind = tells(t_s, name, np.array([0.5, 3.0]) + gust)
        if wind is not None:
            north, east = (round(100.0 * float(x)) for x in wind)
            told.append(EncodedWindReport(name, 2, *place, 40, north, east, 25, 25))
    return SharedWinds(
        vehicle="d1", instance_id="a", as_of_s=0.0, lat_deg=DEPOT[0], lon_deg=DEPOT[1],
        reports=told, front=front,
    )  # fmt: skip


class Flown:
    """One flight; `tells` None: no wind reports. `front`: reported 40 s after departure, and
    withdrawn after `withdrawn_after_s`.
    """

    def __init__(
        self,
        tells: Tells | None,
        until_s: float = 1e6,
        front: EncodedFront | None = None,
        volts: float = 25.0,
        withdrawn_after_s: float | None = None,
    ) -> None:
        route_energy = RouteEnergy.for_mission(AIRFRAME, FAR.mission, 1.225)
        judge = FlightEstimates(
            FAR, AIRFRAME, route_energy, WIND_PROCESS, wind_filter=ScriptedWind()
        )
        self.made: World = world(flight=FAR, judge=judge)  # type: ignore[arg-type]
        self.made.volts = volts
        self.front_s: float | None = None
        left_s: float | None = None
        told_s = 0.0
        while self.made.pilot.phase not in (Phase.DONE, Phase.GROUNDED):
            assert self.made.t_s < 1500.0
            self.made.step()
            now_s = self.made.t_s
            if left_s is None and self.made.pilot.phase is Phase.OUTBOUND:
                left_s = now_s
            due = now_s - told_s >= 10.0 and tells is not None and now_s <= until_s
            comes = front is not None and self.front_s is None and left_s is not None
            if comes and left_s is not None and now_s - left_s >= 40.0:
                self.front_s, due = now_s, True
            over = withdrawn_after_s is not None and (
                withdrawn_after_s < 0.0  # no report before
                or (self.front_s is not None and now_s - self.front_s >= withdrawn_after_s)
            )
            if due or over:
                told_s = now_s
                sent = front if self.front_s == now_s and front is not None else msgspec.UNSET
                if over:
                    sent, withdrawn_after_s = None, None
                winds = word(now_s, tells or (lambda t, n, w: None), sent)
                self.made.tell(ev.FleetWindReceived(now_s, winds, 0.0))

    @property
    def decided(self) -> list[Any]:
        """Return all decisions and assessments, except log entries on the fleet's wind."""
        return [
            action
            for _, action in self.made.log
            if isinstance(action, AssessmentReport)
            or (isinstance(action, Decision) and action.kind != "fleet_wind")
        ]

    def words(self) -> list[str]:
        return [a.reason for _, a in self.made.log if isinstance(a, Decision)]

    def decision(self, kind: str) -> tuple[float, Decision] | None:
        found = [(t, a) for t, a in self.made.log if isinstance(a, Decision) and a.kind == kind]
        return found[0] if found else None


def honest(t_s: float, name: str, wind: Any) -> Any:
    return wind


def lying(t_s: float, name: str, wind: Any) -> Any:
    return wind + np.array([0.0, 8.0])


def frozen(t_s: float, name: str, wind: Any) -> Any:
    return 0.5, 3.0 + 0.1 * len(name)


@pytest.fixture(scope="module")
def alone() -> Flown:
    return Flown(None)


@pytest.mark.sample
def test_honest_winds_are_used_and_said_in_the_decision_and_to_people(alone: Flown) -> None:
    flown = Flown(honest)
    assert flown.decided != alone.decided
    go = flown.decision("go")
    assert go is not None
    assert "; wind of the fleet: 3 others" in go[1].reason
    said = [a.text for _, a in flown.made.log if isinstance(a, AlertReport)]
    assert any(
        words.startswith("wind of the fleet: 3 others: next 5 min") and "own estimate" in words
        for words in said
    )
    assert flown.decision("fleet_wind") is not None
    assert not any("wind of the fleet" in words for words in alone.words())


@pytest.mark.sample
@pytest.mark.parametrize(
    "tells", [lying, lambda t, n, w: None], ids=["the desk lies from the start", "it tells nothing"]
)
def test_with_a_desk_that_is_not_believed_every_decision_is_as_if_alone(
    alone: Flown, tells: Tells
) -> None:
    assert Flown(tells).decided == alone.decided


@pytest.mark.sample
@pytest.mark.parametrize(("tells", "until_s"), [(honest, 60.0), (frozen, 1e6)])
def test_after_the_desk_falls_silent_or_is_frozen_the_answers_are_again_as_if_alone(
    alone: Flown, tells: Tells, until_s: float
) -> None:
    flown = Flown(tells, until_s)
    ends = [a for a in flown.decided if isinstance(a, AssessmentReport)]
    ends_alone = [a for a in alone.decided if isinstance(a, AssessmentReport)]
    assert ends[-1] == ends_alone[-1]
    assert any("not used" in words for words in flown.words())


AGAINST = EncodedFront(
    arrives_in_s=45.0, slow_n_spm=0.0, slow_e_spm=0.05, std_s=12.0, slow_std_spm=0.001,
    post_front_n_mps=15.0, post_front_e_mps=3.0, change_mps=14.0,
)  # fmt: skip


@pytest.mark.sample
def test_a_front_that_is_told_is_judged_within_ten_seconds_and_only_against_flying_on() -> None:
    calm, against = Flown(None, volts=24.05), Flown(None, front=AGAINST, volts=24.05)
    helping = msgspec.structs.replace(AGAINST, post_front_n_mps=-4.0, post_front_e_mps=0.0)
    helped = Flown(None, front=helping, volts=24.05)
    assert calm.decision("turn_back") is None
    turned = against.decision("turn_back")
    assert turned is not None
    assert against.front_s is not None
    assert 0.0 <= turned[0] - against.front_s <= REJUDGED_S
    assert "wind of the fleet: a front" in turned[1].reason
    assert any("a front of 14 m/s, here in" in words for words in against.words())
    assert helped.decision("turn_back") is None
    hopes, told = (
        [a for a in f.decided if isinstance(a, AssessmentReport)] for f in (calm, helped)
    )
    pairs = list(zip(hopes, told, strict=True))
    assert all(with_it.p_home <= without.p_home for without, with_it in pairs)
    assert any(with_it.p_home < without.p_home for without, with_it in pairs), "canary"


@pytest.mark.sample
def test_a_front_that_is_withdrawn_counts_no_more() -> None:
    """The canary: the same front, not withdrawn, keeps its effect."""
    far = msgspec.structs.replace(
        AGAINST, arrives_in_s=200.0, post_front_n_mps=-4.0, post_front_e_mps=0.0
    )
    calm, told = Flown(None, volts=24.05), Flown(None, front=far, volts=24.05)
    over = Flown(None, front=far, volts=24.05, withdrawn_after_s=20.0)
    assert over.front_s is not None
    assert told.front_s == over.front_s
    before, after = over.front_s + 20.0, over.front_s + 22.0

    def hopes(flown: Flown) -> list[tuple[float, float]]:
        return [(t, a.p_home) for t, a in flown.made.log if isinstance(a, AssessmentReport)]

    def differ(flown: Flown) -> list[float]:
        pairs = zip(hopes(calm), hopes(flown), strict=False)
        return [t for (t, without), (_, with_it) in pairs if with_it != without]

    assert any(t < before for t in differ(over))
    assert max(differ(over)) <= after
    assert any(t > after for t in differ(told))
    words = [one for one in over.words() if "front" in one]
    assert words[-1].endswith("the front is withdrawn")


@pytest.mark.sample
def test_a_word_that_withdraws_what_was_never_told_says_nothing() -> None:
    flown = Flown(lambda t_s, name, wind: wind, withdrawn_after_s=-math.inf)
    assert not [one for one in flown.words() if "front" in one]
