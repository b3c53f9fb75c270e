"""The return budget without control: alarms before the last moment to return (fake vehicle)."""

import math
from dataclasses import dataclass, replace

import msgspec
import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import AlertReport, JumpTo, PublishValues, SaveCheckpoint
from companion.core.mission.alerts import Alert
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import Mode
from companion.core.pilot.transitions import Phase
from companion.core.return_budget.budget import Assessment, RemainingMission
from companion.core.return_budget.remaining_mission import ReturnRoute
from companion.core.routing.leg_energy import LegKind, RouteEnergy
from companion.core.vehicle.energy_ledger import EnergyBelief
from tests.companion.pilot.fake_vehicle import AIRFRAME, FLIGHT, ScriptedJudge, World, start, world

POWER_W, LANDING_S, FULL_WH = 400.0, 30.0, 110.0


@dataclass
class EnergyJudge(ScriptedJudge):
    """Judge with constant power: P(home) is 0.999 above the reserve, else 0.9 or less."""

    left_wh: float = 60.0

    @property
    def energy(self) -> EnergyBelief:
        return EnergyBelief(self.t_s, self.left_wh, 1.0, FULL_WH, "test")

    def need_wh(self, route: ReturnRoute) -> float:
        seconds = 0.0
        for leg in route.leg_sequence:
            if leg.kind is LegKind.CRUISE:
                length_m = math.dist(leg.from_ned_m[:2], leg.to_ned_m[:2])
                seconds += length_m / (leg.ground_speed_mps or 10.0)
            seconds += LANDING_S if leg.kind is LegKind.LAND else leg.duration_s
        return seconds * POWER_W / 3600.0

    def assess(self, ahead: RemainingMission) -> Assessment | None:
        needs = {r.landing: self.need_wh(r) for r in ahead.current_return_routes}
        best = min(needs, key=lambda name: needs[name])
        margin_wh = self.left_wh - 0.15 * FULL_WH - needs[best]
        p_now = 0.999 if margin_wh > 0.0 else max(0.9 + margin_wh / 100.0, 0.0)
        return Assessment(
            self.t_s, p_now, p_now, 0.9, margin_wh, not ahead.stages, best, None, self.left_wh,
            needs[best], "test",
        )  # fmt: skip


def reach(phase: Phase) -> World:
    return world(judge=EnergyJudge(RouteEnergy.for_mission(AIRFRAME, FLIGHT.mission, 1.225))).until(
        phase
    )


def hover(w: World, duration_s: float, drift_mps: tuple[float, float] = (0.0, 0.0)) -> World:
    """Let the vehicle stay or drift in its mode; the pack is drawn down."""

    def stay(dt_s: float) -> None:
        w.velocity = (*drift_mps, 0.0)
        w.north, w.east = w.north + drift_mps[0] * dt_s, w.east + drift_mps[1] * dt_s
        w.judge.left_wh -= POWER_W * dt_s / 3600.0  # type: ignore[attr-defined]

    w.fly = stay  # type: ignore[method-assign]
    w.steps(round(10.0 * duration_s))
    return w


def alarms(w: World, alert: Alert) -> list[tuple[float, str]]:
    return [(t, a.text) for t, a in w.log if isinstance(a, AlertReport) and a.alert is alert]


def last_moment_s(w: World) -> float:
    """Return when the direct return to the nearest site at 5 m/s meets the reserve only just."""
    away_m = min(math.dist((w.north, w.east), at) for at in ((0.0, 0.0), (150.0, 120.0)))
    left_wh = w.judge.left_wh - 0.15 * FULL_WH  # type: ignore[attr-defined]
    return w.t_s + left_wh * 3600.0 / POWER_W - LANDING_S - away_m / 5.0


def hold(w: World) -> World:
    w.mode = Mode.HOLD
    return w


def fly_by_hand(w: World) -> World:
    w.mode = Mode.OTHER
    return w


def yield_to_other(w: World) -> World:
    w.tell(ev.OtherCompanionReport(w.t_s, active=True, has_control=True, component=190))
    return w


def restart_over_foreign_mission(w: World) -> World:
    kept = [a.content for _, a in w.log if isinstance(a, SaveCheckpoint)][-1]
    made = world(kept=msgspec.convert(kept, Checkpoint), armed=True, judge=w.judge)
    again = w.with_pilot_of(made)
    again.items = (replace(again.items[0], value=1.0), *again.items[1:-1])
    start(again)
    return again


@pytest.mark.parametrize("phase", [Phase.OUTBOUND, Phase.RETURN])
@pytest.mark.parametrize(
    ("release", "found"),
    [
        (hold, Phase.SUSPENDED),
        (fly_by_hand, Phase.SUSPENDED),
        (yield_to_other, Phase.PASSIVE),
        (restart_over_foreign_mission, Phase.FOREIGN_MISSION),
    ],
)
def test_the_return_alarm_comes_a_minute_before_the_last_moment_in_every_phase_without_control(
    release, found, phase
):
    w = reach(phase)
    w.run(lambda w: w.north > 200.0)
    w = release(w)
    released_s = w.t_s
    hover(w, 5.0)
    assert w.pilot.phase is found
    assert not alarms(w, Alert.RETURN_DUE)
    last_s = last_moment_s(w)
    hover(w, last_s - w.t_s - 3.0)
    times_s = [t for t, _ in alarms(w, Alert.RETURN_DUE)]
    assert times_s[0] == pytest.approx(last_s - 60.0, abs=2.0)
    assert len(times_s) == 6, "every 10 s"
    assert "return to quay, " in alarms(w, Alert.RETURN_DUE)[0][1]
    assert w.sent(PublishValues)[-1].values["LW_TLEFT"] < 5.0
    assert not w.orders_after(released_s + 2.0)
    hover(w, 200.0)
    assert "0 s left: land here" in alarms(w, Alert.RETURN_DUE)[-1][1]


@pytest.mark.parametrize(
    ("left_wh", "drift_mps", "alarm_in_s"),
    [
        (33.0, 0.0, 40.0),
        (33.0, 5.0, 0.0),  # each second away costs another one back
        (27.0, 0.0, 0.0),
        (27.0, -5.0, None),  # returning
    ],
)
def test_who_flies_away_is_warned_earlier_and_who_returns_is_not(left_wh, drift_mps, alarm_in_s):
    w = reach(Phase.OUTBOUND)
    w.run(lambda w: w.north > 90.0)
    w.mode, w.judge.left_wh, taken_s = Mode.OTHER, left_wh, w.t_s  # type: ignore[attr-defined]
    hover(w, 16.0 if alarm_in_s is None else 45.0, (drift_mps, 0.0))
    found = [t - taken_s for t, _ in alarms(w, Alert.RETURN_DUE)]
    assert found[:1] == ([] if alarm_in_s is None else [pytest.approx(alarm_in_s, abs=2.5)])


@pytest.mark.parametrize(
    ("left_wh", "speed_mps", "advice"),
    [
        (30.0, 5.0, None),
        (30.0, 0.8, "fly to quay, "),  # held up by the wind, as measured
        (3.0, 0.8, "land here"),
    ],
)
def test_an_rtl_that_does_not_arrive_is_reported_with_a_site_or_a_landing(
    left_wh, speed_mps, advice
):
    w = reach(Phase.RETURN)
    w.mode, w.judge.left_wh = Mode.RTL, left_wh  # type: ignore[attr-defined]
    hover(w, 15.0, (-speed_mps, 0.0))
    assert w.pilot.phase is Phase.SUSPENDED
    found = alarms(w, Alert.RTL_OUT_OF_REACH)
    assert bool(found) is (advice is not None)
    assert not found or advice in found[0][1]
    assert not alarms(w, Alert.RETURN_DUE)


def test_a_return_assessed_during_a_hold_does_not_close_the_gate_of_the_resumed_mission():
    w = reach(Phase.OUTBOUND)
    fly = w.fly
    hover(hold(w), 5.0)
    w.fly = fly  # type: ignore[method-assign]
    handed_s = w.t_s
    w.tell(ev.ControlHandedBack(w.t_s, "255/190"))
    w.until(Phase.OUTBOUND, 20.0)
    w.steps(20)
    assert w.pilot.phase is Phase.OUTBOUND
    assert not w.sent(JumpTo, handed_s)
