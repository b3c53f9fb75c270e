"""The simulated day's desk: waits for its store, restarts, and accepts operator commands."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import sqlalchemy as sa

from ground_station.adapters.store import tables
from ground_station.app.desk.desk import Desk
from sim_bridge.app.day.build import build_day
from sim_bridge.app.day.desk import LOG_FILE, SteppedDesk
from sim_bridge.app.day.store_host import SqliteHost
from sim_bridge.app.trials import day_case, days
from sim_bridge.app.trials.trial import TrialRow

CASE = day_case.DayCase(
    seed=1, site="harbour", autopilots=("px4",), orders=("H-102", "H-108"), drones_only=False,
    forecast_mps=3.0, forecast_from_deg=80.0, front_mps=0.0, charge_frac=0.97, temperature_c=15.0,
    loss=0.0, network_cuts=0, companion_kills=0, ground_kills=0, take_overs=0, truck_late_s=0.0,
    searches=50, truck=False,
)  # fmt: skip


@pytest.fixture
def seat(tmp_path: Path) -> Iterator[SteppedDesk]:
    """Yield the desk of a day that is not stepped."""
    built = build_day(day_case.build_day_data(CASE), CASE.world_options, CASE.seed, tmp_path, 60.0)
    made = SteppedDesk.start_depot_desk(built, tmp_path, SqliteHost(tmp_path))
    yield made
    made.close()


def said(seat: SteppedDesk) -> str:
    return (seat.folder / LOG_FILE).read_text()


def test_a_desk_that_is_started_while_its_store_is_away_waits_and_says_so_once(seat):
    seat.kill()
    seat.host.start_outage_and_describe()
    seat.restart()
    for _ in range(3):
        seat.run_desk_cycle()
    assert seat.desk is None
    assert not seat.is_done
    seat.host.end_outage()
    seat.run_desk_cycle()
    assert seat.desk is not None
    assert said(seat).count("waits for its store") == 1


def test_a_desk_that_was_killed_stays_down_until_it_is_started(seat):
    seat.kill()
    seat.run_desk_cycle()
    assert seat.desk is None
    seat.restart()
    assert seat.desk is not None


def test_a_desk_that_raises_in_its_turn_has_ended_by_itself_and_is_started_again(seat, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Desk, "run_cycle", lambda self, wait_s: [][0])
        seat.run_desk_cycle()
    assert seat.unexpected_exits == ["desk at 0.0 s: IndexError: list index out of range"]
    assert "Traceback" in said(seat)
    seat.run_desk_cycle()
    assert seat.desk is not None


def test_a_day_in_which_the_desk_ended_by_itself_does_not_hold(tmp_path, monkeypatch):
    """Its only order is the truck's, so that no drone flies."""
    turn, turns = Desk.run_cycle, list[Desk]()

    def falls_once(self: Desk, wait_s: float) -> None:
        turns.append(self)
        if len(turns) == 2:
            raise RuntimeError("made by a test")
        turn(self, wait_s)

    def attempt() -> TrialRow:
        case = msgspec.structs.replace(CASE, orders=("H-108",))
        return days.run_case(case, tmp_path / "day")

    assert attempt().passed
    monkeypatch.setattr(Desk, "run_cycle", falls_once)
    row = attempt()
    assert "ended by itself: desk at 0.6 s: RuntimeError: made by a test" in row.reason
    assert "an exception: desk.log" in row.reason


@pytest.mark.parametrize(("gone", "state"), [(True, "delivered"), (False, "open")])
def test_people_say_of_a_parcel_that_waits_for_them_where_it_is(seat, gone, state):
    seat.parcel_missing_by_order["H-102"] = gone
    seat.run_desk_cycle()
    assert "H-102" in seat.parcel_missing_by_order
    with seat.database.database.write() as db:
        db.execute(sa.update(tables.orders).values(state="stuck"))
    seat.run_desk_cycle()
    assert seat.build_desk_record().orders["H-102"].state.value == state
    assert seat.build_desk_record().orders["H-108"].state.value == "stuck"
