"""The long trials, a drawn sample of each; each trial fails without its guard.

A guard is disabled by a patch of this test: in the companion's process before its `main` runs, or
in this one where the trial steps the flight code itself.
"""

from functools import partial

import msgspec
import pytest

from companion.adapters.autopilots.codec import mavlink
from companion.app.flight.loop import Loop
from companion.app.flight.receive_backlog import ReceiveBacklog
from companion.core.base.errors import LeewayError
from sim_bridge.adapters.postgres_server import PostgresExecutables
from sim_bridge.app.flight import companion_process
from sim_bridge.app.trials import day_case, days, fuzz, logs, soak, stall
from sim_bridge.autopilot.kinds import AUTOPILOTS

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(900)]

CALM = fuzz.FuzzCase(
    autopilot="px4",
    seed=1,
    altered_frac=0.01,
    start_s=50.0,
    end_s=51.0,
    alteration_kinds=("doubled",),
    messages=("VFR_HUD",),
    pilot_override_after_s=5.0,
)
"""Practically no false messages; a pilot override on the outbound leg."""

GUARDS = {
    "commands after the take-over": "from companion.app.flight.loop import Loop;"
    " from companion.adapters.autopilots.codec import mavlink;"
    " step = Loop.step; Loop.step = lambda self: (step(self),"
    " self.pilot.phase.value == 'suspended' and self.send_queue.queue_order_unless_backlog("
    "mavlink.MAVLink_mission_set_current_message(1, 1, 1)));",
    "an exception": "from companion.core.pilot.authority import OrderedMode;"
    " OrderedMode.update_and_get_takeover_reason = lambda self, *a, **k: [][0];",
    "energy left rose": "from companion.core.vehicle import energy_ledger as e;"
    " belief = e.EnergyLedger.energy_belief_or_none; from dataclasses import replace;"
    " e.EnergyLedger.energy_belief_or_none = lambda self: belief(self) and"
    " replace(belief(self), mean_wh=belief(self).mean_wh + belief(self).t_s);",
    "recording stopped": "from companion.core.mission import actions as a;"
    " from companion.app.flight.recorder import Recorder; from dataclasses import replace;"
    " take = Recorder.record_action; Recorder.record_action = lambda self, one, t_s: take(self,"
    " replace(one, p_home=float('nan')) if isinstance(one, a.AssessmentReport) else one, t_s);",
}
"""The patch, by the violation that the trial then reports."""


def stores() -> tuple[str, ...]:
    try:
        PostgresExecutables.find()
    except LeewayError:
        return (day_case.SQLITE,)
    return day_case.STORE_KINDS


def broken(rows) -> list[tuple[str, str]]:
    return [(row.name, row.reason) for row in rows if not row.passed]


@pytest.mark.sample
@pytest.mark.drawn(keep=8)
@pytest.mark.parametrize("number", range(60))
def test_an_autopilot_that_lies_never_makes_us_break_a_rule(tmp_path, number):
    assert not broken([fuzz.run_case(fuzz.draw_case(0, number), tmp_path / "fuzz")])


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("guard", GUARDS)
def test_without_its_guard_a_flight_under_lies_breaks(tmp_path, monkeypatch, guard):
    entry = f"{GUARDS[guard]} {companion_process.COMPANION_CODE}"
    monkeypatch.setattr(fuzz, "suite_fork_server", lambda: None)  # patched before its imports
    monkeypatch.setattr(companion_process, "COMPANION_CODE", entry)
    assert guard in fuzz.run_case(CALM, tmp_path / "fuzz").reason


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("seed", range(4))
def test_safety_rule_1_nothing_is_commanded_after_a_stall_at_any_second(tmp_path, seed):
    flyer = partial(stall.run_flight, tmp_path)
    flights = list(
        stall.group_cases_into_shared_flights(
            stall.draw_random_subset_of_cases(seed, AUTOPILOTS, 20)
        )
    )
    rows = [row for flight in flights for row in flyer(flight)]
    assert not broken(rows)
    assert sum(row.metrics["had_effect"] for row in rows) > 10


@pytest.mark.sample
def test_without_hearing_what_waited_commands_leave_after_a_stall(tmp_path, monkeypatch):
    monkeypatch.setattr(ReceiveBacklog, "register_cycle", lambda self: None)
    cases = [stall.draw_case(1, "px4", at_s, 6.0) for at_s in (36.0, 42.0, 44.0)]
    (flight,) = stall.group_cases_into_shared_flights(cases)
    assert len(broken(stall.run_flight(tmp_path, flight))) == len(cases)


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("seed", range(100, 115))
def test_damaged_logs_are_replayed_or_refused_within_bounds_and_in_silence(tmp_path, seed):
    cases = [logs.draw_case(seed, number) for number in range(70)]
    assert not broken(logs.read_damaged_logs_in_parallel(cases, tmp_path))


@pytest.mark.night
def test_ten_minutes_of_standby_and_flights_leave_no_more_in_memory(tmp_path):
    case = soak.SoakCase(seed=1, hours=1.0 / 6.0, flight_interval_min=3.2)
    row = soak.run_case(case, tmp_path / case.name)
    assert row.passed, row.reason
    assert row.metrics["flights"] >= 3


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("number", range(12))
def test_a_small_day_under_drawn_faults_keeps_every_rule(tmp_path, number):
    """With a truck and from a depot, on SQLite and on PostgreSQL, where a server is installed."""
    drawn = day_case.draw_case(0, number, max_vehicles=2, max_orders_per_vehicle=1)
    store = stores()[number % len(stores())]
    case = msgspec.structs.replace(drawn, drones_only=True, store=store)
    assert not broken([days.run_case(case, tmp_path / case.name)])


TAKEN = day_case.DayCase(
    seed=1, site="harbour", autopilots=AUTOPILOTS, orders=("H-102", "H-107"), drones_only=True,
    forecast_mps=3.0, forecast_from_deg=80.0, front_mps=0.0, charge_frac=0.97, temperature_c=15.0,
    loss=0.0, network_cuts=0, companion_kills=0, ground_kills=0, take_overs=1, truck_late_s=0.0,
    searches=50,
)  # fmt: skip
"""A person takes over one drone; no other fault."""


@pytest.mark.sample
def test_without_its_guard_a_day_stops_at_the_first_command(tmp_path, monkeypatch):
    step = Loop.step

    def jumps_too(self) -> None:
        step(self)
        if self.pilot.phase.value == "suspended":
            self.send_queue.queue_order_unless_backlog(
                mavlink.MAVLink_mission_set_current_message(1, 1, 1)
            )

    monkeypatch.setattr(Loop, "step", jumps_too)
    row = days.run_case(TAKEN, tmp_path / TAKEN.name)
    assert "after the pilot override" in row.reason
