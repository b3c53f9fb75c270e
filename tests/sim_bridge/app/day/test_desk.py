"""The simulated day's desk: it waits for its store, is started again, and people speak to it."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import sqlalchemy as sa

from ground_station.adapters.store import tables
from ground_station.app.desk.desk import Desk
from sim_bridge.app.day.build import build_day, here
from sim_bridge.app.day.desk import LOG, DeskHere
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
def seat(tmp_path: Path) -> Iterator[DeskHere]:
    """Of a day that nobody steps."""
    plumb = here(0.0, tmp_path)
    built = build_day(day_case.data_of(CASE), CASE.wish, CASE.seed, tmp_path, 60.0, plumb)
    made = DeskHere.at_depot(built, tmp_path, SqliteHost(tmp_path))
    yield made
    made.close()
    built.plumbing.close()


def said(seat: DeskHere) -> str:
    return (seat.folder / LOG).read_text()


def test_a_desk_that_is_started_while_its_store_is_away_waits_and_says_so_once(seat):
    seat.kill()
    seat.host.take_away()
    seat.start()
    for _ in range(3):
        seat.turn()
    assert seat.desk is None
    assert not seat.is_done
    seat.host.bring_back()
    seat.turn()
    assert seat.desk is not None
    assert said(seat).count("waits for its store") == 1


def test_a_desk_that_was_killed_stays_down_until_it_is_started(seat):
    seat.kill()
    seat.turn()
    assert seat.desk is None
    seat.start()
    assert seat.desk is not None


def test_a_desk_that_raises_in_its_turn_has_ended_by_itself_and_is_started_again(seat, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Desk, "turn", lambda self, wait_s: [][0])
        seat.turn()
    assert seat.ended_by_itself == ["desk at 0.0 s: IndexError: list index out of range"]
    assert "Traceback" in said(seat)
    seat.turn()
    assert seat.desk is not None


def test_a_day_in_which_the_desk_ended_by_itself_does_not_hold(tmp_path, monkeypatch):
    """Its one order is the truck's, so that nothing flies."""
    turn, turns = Desk.turn, list[Desk]()

    def falls_once(self: Desk, wait_s: float) -> None:
        turns.append(self)
        if len(turns) == 2:
            raise RuntimeError("made by a test")
        turn(self, wait_s)

    def attempt() -> TrialRow:
        case = msgspec.structs.replace(CASE, orders=("H-108",))
        return days.attempt(case, tmp_path / "day")

    assert attempt().held
    monkeypatch.setattr(Desk, "turn", falls_once)
    row = attempt()
    assert "ended by itself: desk at 0.6 s: RuntimeError: made by a test" in row.why
    assert "an exception: desk.log" in row.why


@pytest.mark.parametrize(("gone", "state"), [(True, "delivered"), (False, "open")])
def test_people_say_of_a_parcel_that_waits_for_them_where_it_is(seat, gone, state):
    seat.gone["H-102"] = gone
    seat.turn()
    assert "H-102" in seat.gone
    with seat.books.database.write() as db:
        db.execute(sa.update(tables.orders).values(state="stuck"))
    seat.turn()
    assert seat.told["H-102"].startswith(state)
    assert seat.told["H-108"].startswith("stuck")
