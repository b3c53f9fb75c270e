"""An unreachable store stops no flight, loses no data, and does not end the desk."""

import sqlite3
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ground_station.adapters.store.database import Database, StoreError
from ground_station.adapters.store.outage import FIRST_RETRY_S, MAX_RETRY_S, Outage
from ground_station.app.desk.exchange import FleetExchange
from ground_station.core.schema.orders import OrderState
from tests.ground_station.desk import test_truck_dispatcher
from tests.ground_station.desk.test_truck_dispatcher import DayTold

AWAY_S = 40.0
ENDED = Outage.record_success_and_end_outage
IMPATIENT = partial(test_truck_dispatcher.MortalDatabase, lock_timeout_ms=1)


@dataclass(slots=True)
class Gone(Outage):
    """A store that becomes unreachable between transactions, at random, for `OUTAGE_S`."""

    rng: np.random.Generator | None = None
    share: float = 0.01
    until_s: float = 0.0
    times: int = 0

    @property
    def is_before_next_retry(self) -> bool:
        now_s = self.clock_s()
        if self.rng is not None and now_s > self.until_s and self.rng.random() < self.share:
            self.times, self.until_s = self.times + 1, now_s + AWAY_S
        return now_s < self.until_s


@pytest.fixture
def told(tmp_path: Path) -> Iterator[tuple[DayTold, Gone]]:
    made = DayTold(f"sqlite:///{tmp_path}/desk.db", 3, 0.1)
    gone = Gone(made.world.clock.monotonic_s, rng=np.random.default_rng(1))
    made.database.outage = gone
    yield made, gone
    made.store.close()


def test_a_day_whose_store_is_away_now_and_then_is_brought_home_each_order_once(told):
    day, gone = told
    day.run()
    day.database.outage = None
    assert gone.times > 3
    assert set(day.states().values()) == {OrderState.DELIVERED}
    assert sorted(day.world.delivered) == sorted(day.states())
    assert day.world.on_truck == {"d1", "d2"}
    assert sum(words.startswith("store unreachable") for words in day.said) > 3
    assert "store reachable again" in day.said


def test_a_desk_that_minds_a_store_that_is_away_would_end(told, monkeypatch):
    day, _ = told
    monkeypatch.setattr(
        FleetExchange, "suppress_and_record_store_outage", lambda self: nullcontext()
    )
    with pytest.raises(StoreError):
        day.run()


@pytest.mark.sample
def test_nothing_is_sent_that_could_not_be_written(told):
    day, gone = told
    gone.rng, gone.until_s = None, float("inf")
    for _ in range(200):
        day.world.step()
        day.desk.run_cycle(0.0)
    assert day.desk.exchange.store_error is not None
    assert day.world.flown == []
    gone.until_s = 0.0
    day.run()
    assert day.desk.exchange.store_error is None


def test_a_store_that_can_be_read_and_not_written_is_away_until_it_can(tmp_path, monkeypatch):
    """Another process holds the write lock for ten minutes."""
    monkeypatch.setattr(test_truck_dispatcher, "MortalDatabase", IMPATIENT)
    day = DayTold(f"sqlite:///{tmp_path}/desk.db", 3)
    day.database.outage = Outage(day.world.clock.monotonic_s)
    other = sqlite3.connect(tmp_path / "desk.db", isolation_level=None)
    for word, seconds in (("BEGIN IMMEDIATE", 600), ("ROLLBACK", 60)):
        other.execute(word)
        for _ in range(seconds):
            day.world.step()
            day.desk.run_cycle(0.0)
    other.close()
    day.store.close()
    assert sum(words.startswith("store unreachable") for words in day.said) == 1
    assert day.said.count("store reachable again") == 1


@pytest.mark.parametrize("guarded", [True, False], ids=["guarded", "canary"])
def test_a_read_that_works_does_not_end_an_outage_of_writing(tmp_path, monkeypatch, guarded):
    """Canary: it does end it, and the retry interval never increases."""
    if not guarded:
        monkeypatch.setattr(
            Outage,
            "record_success_and_end_outage",
            lambda self, is_write: ENDED(self, is_write=True),
        )
    now_s, failures = 0.0, 0
    database = Database(
        f"sqlite:///{tmp_path}/d.db", lock_timeout_ms=1, outage=Outage(lambda: now_s)
    )
    other = sqlite3.connect(tmp_path / "d.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    assert database.outage is not None
    for _ in range(100):
        now_s += 1.0
        if database.outage.is_before_next_retry:
            continue
        with database.read() as db:
            db.exec_driver_sql("SELECT * FROM about")
        with pytest.raises(StoreError), database.write():
            pass
        failures += 1
    assert (failures < 10) is guarded
    other.execute("ROLLBACK")
    now_s += MAX_RETRY_S
    database.probe_write_after_failure()
    assert database.outage.reason is None
    other.close()
    database.close()


def test_a_store_that_is_away_is_tried_again_ever_more_seldom(tmp_path: Path):
    now_s = 0.0
    outage, tried_s = Outage(lambda: now_s), []
    while now_s < 200.0:
        if not outage.is_before_next_retry:
            tried_s.append(now_s)
            outage.record_failure_and_schedule_retry("gone")
        now_s += 0.5
    waits_s = list(np.diff(tried_s))
    assert waits_s[:5] == [FIRST_RETRY_S, 2.0, 4.0, 8.0, 16.0]
    assert set(waits_s[5:]) == {MAX_RETRY_S}
    outage.record_success_and_end_outage()
    assert not outage.is_before_next_retry


def test_a_store_that_another_process_locks_is_away_and_nobody_waits_for_it_twice(tmp_path: Path):
    now_s = 0.0
    url = f"sqlite:///{tmp_path}/d.db"
    database = Database(url, lock_timeout_ms=1, outage=Outage(lambda: now_s))
    other = sqlite3.connect(tmp_path / "d.db", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")

    def write() -> None:
        with database.write() as db:
            db.exec_driver_sql("UPDATE about SET value = value")

    with pytest.raises(StoreError, match="database is locked"):
        write()
    other.execute("ROLLBACK")
    with pytest.raises(StoreError, match="database is locked"):
        write()  # no attempt: too early
    now_s = FIRST_RETRY_S
    write()
    assert database.outage is not None
    assert database.outage.reason is None
    other.close()
    database.close()
