"""The long trials, a drawn sample of each; and each guard taken out, so that its trial breaks.

A guard is taken out by a patch of this test's: in the companion's process before its `main` runs,
or in this one where the trial steps the flight code itself.
"""

import msgspec
import pytest

from companion.app.flight.hearing import Hearing
from companion.app.flight.loop import Loop, mavlink
from companion.core.base.errors import LeewayError
from sim_bridge.adapters.postgres_server import PostgresPrograms
from sim_bridge.app.flight import companion_process
from sim_bridge.app.trials import day_case, days, fuzz, logs, soak, stall

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(900)]

BOTH = ("px4", "ardupilot")

CALM = fuzz.FuzzCase(
    autopilot="px4",
    seed=1,
    share=0.01,
    begins_s=50.0,
    ends_s=51.0,
    deeds=("doubled",),
    messages=("VFR_HUD",),
    takes_over_after_s=5.0,
)
"""As good as no lies; a pilot takes over while it flies out."""

GUARDS = {
    "commands after hands off": "from companion.app.flight.loop import Loop, mavlink;"
    " beat = Loop._heartbeat; Loop._heartbeat = lambda self: (beat(self),"
    " self.pilot.phase.value == 'suspended'"
    " and self.send_order(mavlink.MAVLink_mission_set_current_message(1, 1, 1)));",
    "an exception": "from companion.core.pilot.authority import Authority;"
    " Authority.intrusion = lambda self, *a, **k: [][0];",
    "energy left rose": "from companion.core.vehicle import energy_ledger as e;"
    " belief = e.EnergyLedger.belief; from dataclasses import replace;"
    " e.EnergyLedger.belief = lambda self: belief(self) and"
    " replace(belief(self), mean_wh=belief(self).mean_wh + belief(self).t_s);",
    "record given up": "from companion.core.mission import actions as a;"
    " from companion.app.flight.recorder import Recorder; from dataclasses import replace;"
    " take = Recorder.take; Recorder.take = lambda self, one, t_s: take(self,"
    " replace(one, p_home=float('nan')) if isinstance(one, a.Assessed) else one, t_s);",
}
"""By what the trial then says: the patch."""


def stores() -> tuple[str, ...]:
    try:
        PostgresPrograms.find()
    except LeewayError:
        return (day_case.SQLITE,)
    return day_case.STORES


def broken(rows) -> list[tuple[str, str]]:
    return [(row.name, row.why) for row in rows if not row.held]


@pytest.mark.drawn(keep=8)
@pytest.mark.parametrize("number", range(60))
def test_an_autopilot_that_lies_never_makes_us_break_a_rule(tmp_path, number):
    assert not broken([fuzz.attempt(fuzz.drawn(0, number), tmp_path)])


@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("guard", GUARDS)
def test_without_its_guard_a_flight_under_lies_breaks(tmp_path, monkeypatch, guard):
    entry = f"{GUARDS[guard]} {companion_process.ENTRY}"
    monkeypatch.setattr(fuzz, "suite_forks", lambda: None)  # patched before its imports
    monkeypatch.setattr(companion_process, "ENTRY", entry)
    assert guard in fuzz.attempt(CALM, tmp_path).why


@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("seed", range(4))
def test_safety_rule_1_nothing_is_commanded_after_a_stall_at_any_second(tmp_path, seed):
    flyer = stall.StallFlyer(tmp_path)
    flights = list(stall.flights(stall.some_cases(seed, BOTH, 20)))
    rows = [row for flight in flights for row in flyer(flight)]
    assert not broken(rows)
    assert sum(row.told["had_effect"] for row in rows) > 10


def test_without_hearing_what_waited_commands_leave_after_a_stall(tmp_path, monkeypatch):
    monkeypatch.setattr(Hearing, "turned", lambda self: 0.0)
    cases = [stall.drawn(1, "px4", at_s, 6.0) for at_s in (36.0, 42.0, 44.0)]
    (flight,) = stall.flights(cases)
    assert len(broken(stall.StallFlyer(tmp_path)(flight))) == len(cases)


@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("seed", range(100, 115))
def test_damaged_logs_are_replayed_or_refused_within_bounds_and_in_silence(tmp_path, seed):
    cases = [logs.drawn(seed, number) for number in range(70)]
    assert not broken(logs.attempts(cases, tmp_path))


def test_ten_minutes_of_standby_and_flights_leave_no_more_in_memory(tmp_path):
    case = soak.SoakCase(seed=1, hours=1.0 / 6.0, every_minutes=3.2)
    row = soak.attempt(case, tmp_path / case.name)
    assert row.held, row.why
    assert row.told["flights"] >= 3


@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("number", range(12))
def test_a_small_day_under_drawn_faults_keeps_every_rule(tmp_path, number):
    """With a truck and from a depot, on SQLite and on PostgreSQL, where a server is installed."""
    drawn = day_case.drawn(0, number, most_vehicles=2, most_orders_each=1)
    store = stores()[number % len(stores())]
    case = msgspec.structs.replace(drawn, drones_only=True, store=store)
    assert not broken([days.attempt(case, tmp_path / case.name)])


TAKEN = day_case.DayCase(
    seed=1, site="harbour", autopilots=BOTH, orders=("H-102", "H-107"), drones_only=True,
    forecast_mps=3.0, forecast_from_deg=80.0, front_mps=0.0, charge_frac=0.97, temperature_c=15.0,
    loss=0.0, network_cuts=0, companion_kills=0, ground_kills=0, take_overs=1, truck_late_s=0.0,
    searches=50,
)  # fmt: skip
"""A person takes over one drone; nothing else is wrong."""


def test_safety_rule_1_without_its_guard_a_day_stops_at_the_first_command(tmp_path, monkeypatch):
    step = Loop.step

    def jumps_too(self) -> None:
        step(self)
        if self.pilot.phase.value == "suspended":
            self.send_order(mavlink.MAVLink_mission_set_current_message(1, 1, 1))

    monkeypatch.setattr(Loop, "step", jumps_too)
    row = days.attempt(TAKEN, tmp_path / TAKEN.name)
    assert "after the take-over" in row.why
