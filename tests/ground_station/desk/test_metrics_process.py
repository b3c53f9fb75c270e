"""The desk as the process that people start, with identities, read over HTTP while it works."""

import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
import zenoh

from companion.fleet.membership import JoinOptions, join
from companion.fleet.messages import FINAL, Assign, EventKind, Launch, Recall
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.adapters.metrics.metrics_page import FRESH_S
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.exchange import ANSWER_S
from ground_station.core.schema.orders import OrderState
from tests.fleet.secure_site import SecureSite
from tests.fleet.zenoh_net import FLEET, free_port
from tests.ground_station.desk.test_depot_dispatcher import Obedient
from tests.ground_station.desk.test_desk_processes import HARBOUR, start
from tests.ground_station.metrics.scrape import Scrape, connected, scrape, scrape_until

pytestmark = pytest.mark.timeout(240)

HANG_S = 3.0
RUBBISH = 5


class Site:
    """A desk's process over a store, two drones with identities, and somebody who scrapes."""

    def __init__(self, folder: Path, held: ExitStack) -> None:
        self.folder, self.held, self.port = folder, held, free_port()
        self.pki = SecureSite(folder / "pki", {"d2": 3})
        self.url = f"sqlite:///{folder}/desk.db"
        self.store = Store(Database(self.url), epoch_us)
        held.callback(self.store.close)
        orders = "H-1,55.4702,8.4460,13.0,0.4\nH-2,55.4712,8.4460,13.0,0.4\n"
        header = "id,lat_deg,lon_deg,alt_amsl_m,mass_kg\n"
        (folder / "harbour_orders.csv").write_text(header + orders)
        text = HARBOUR.read_text().replace('no_fly = "../sites/harbour.geojson"\n', "")
        (folder / "day.toml").write_text(text)

    def desk(self) -> "subprocess.Popen[str]":
        """The command that people start."""
        process = start(
            self.folder, "dispatch", "day.toml", f"--store={self.url}", "--auto-launch",
            f"--identity={self.pki.home('desk')}", f"--metrics={self.port}", "--launch-gap=0",
        )  # fmt: skip
        self.held.callback(process.wait)
        self.held.callback(process.kill)
        return process

    def drone(self, name: str) -> Obedient:
        """A drone of the fleet."""
        options = JoinOptions(self.pki.home(name))
        membership = join(VehicleKeys(FLEET, name), None, options)
        made = Obedient.on(name, self.folder / name, membership.open_link)
        assert isinstance(made, Obedient)
        self.held.callback(made.port.close)
        self.held.callback(made.stop)
        return made

    def publish_rubbish(self, name: str) -> None:
        """On its own key, with its own certificate."""
        config = read_config(self.pki.home(name) / "zenoh.json5")
        with zenoh.open(config) as session:
            for _ in range(RUBBISH):
                session.put(VehicleKeys(FLEET, name).event, b"rubbish")

    def until(self, true: Callable[[Scrape], object]) -> Scrape:
        """The first page of which it is true."""
        return scrape_until(self.port, true)

    def read(self) -> Scrape:
        """The page now."""
        return scrape(self.port)

    def answered(self) -> dict[str, int]:
        """Commands that a vehicle has answered, by deed, as the store has them."""
        rows = [row for row in self.store.commands() if row.answer in FINAL and row.life]
        deeds = [str(row.deed.__struct_config__.tag) for row in rows]
        return {deed: deeds.count(deed) for deed in deeds}


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with ExitStack() as held:
        yield Site(tmp_path, held)


def times(seen: Scrape) -> dict[str, float | None]:
    deeds = seen.label_values("command_answer_seconds_count", "deed")
    return {deed: seen.of("command_answer_seconds_count", deed=deed) for deed in deeds}


def test_what_happens_in_a_small_exchange_is_what_the_page_says(site):
    HoldStore(site.store.database, epoch_us).set(["d2"], "a cracked arm", "anna")
    began_s = monotonic_s()
    desk = site.desk()
    with ExitStack() as nobody:
        d1, d2 = site.drone("d1"), site.drone("d2")
        d1.flies = False  # until it is told to land
        scrape_when_up(site, desk)
        for _ in range(20):  # more than are answered at once
            nobody.enter_context(connected(site.port))
        for flight in (1, 2):
            seen = site.until(lambda page, n=flight: times(page).get("launch") == n)
            d1.land()
    assert times(seen) == site.answered() == {"assign": 2, "launch": 2}
    assert [type(command.deed) for command in d1.done] == [Assign, Launch] * 2
    assert d2.done == []  # held
    took_s = seen.of("command_answer_seconds_sum", deed="launch") or 0.0
    assert 0.0 < took_s < 2 * (monotonic_s() - began_s)
    site.until(lambda _: all(r.state is OrderState.DELIVERED for r in site.store.orders()))
    seen = site.until(lambda page: page.of("outbox_commands") == 0)
    assert seen.of("members", standing="present") == 2
    assert seen.of("members_held") == 1
    assert (seen.of("store_up"), seen.of("open_network")) == (1, 0)
    assert 0.0 < (seen.of("store_transaction_seconds") or 0.0) < monotonic_s() - began_s
    assert seen.of("own_certificate_days_left") == pytest.approx(365, abs=0.01)
    assert seen.of("certificate_days_left", member="d2") == pytest.approx(3, abs=0.01)
    assert seen.label_values("certificate_days_left", "member") == {*MEMBERS}

    site.publish_rubbish("d1")
    rejected = ("messages_rejected_total", "d1")
    seen = site.until(lambda page: page.of(rejected[0], vehicle="d1") == RUBBISH)
    assert seen.label_values(rejected[0], "vehicle") == {"d1"}

    d1.stop()  # its process hangs: the network still knows it
    asked_us = epoch_us()
    site.store.command("c1", "d1", Recall(), "anna")
    seen = site.until(
        lambda page: (
            page.of("command_timeouts_total", deed="recall")
            and page.of("members", standing="silent") == 1
        )
    )
    assert seen.of("outbox_commands") == 1
    assert seen.of("commands_unanswered", deed="recall") == 1
    age_s = (epoch_us() - asked_us) / 1e6
    assert ANSWER_S <= (seen.of("outbox_oldest_seconds") or 0.0) <= age_s
    assert_silence_grows_with_time(site, "d1")

    with closing(sqlite3.connect(site.folder / "desk.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")  # a copy, a backup, a disk that stalls
        d2.port.tell(EventKind.SAID, "the desk is to write this down")
        site.until(lambda page: (page.of("seconds_since_turn") or 0.0) > HANG_S)
        other.execute("ROLLBACK")
    site.until(lambda page: (page.of("seconds_since_turn") or HANG_S) < HANG_S)
    assert desk.poll() is None


MEMBERS = ("d1", "d2", "truck", "anna", "otto")


def scrape_when_up(site: Site, desk: "subprocess.Popen[str]") -> None:
    """Wait until the desk has its port: taking orders in and planning come first."""
    until_s = monotonic_s() + 120.0
    while True:
        try:
            site.read()
        except OSError:
            said = (site.folder / "dispatch.out").read_text()
            assert desk.poll() is None, said
            assert monotonic_s() < until_s, said
            time.sleep(0.2)
        else:
            return


def assert_silence_grows_with_time(site: Site, name: str) -> None:
    def silent_s() -> tuple[float, float, float]:
        before_s = monotonic_s()
        found_s = site.read().of("member_silence_seconds", vehicle=name)
        assert found_s is not None
        return before_s - FRESH_S, found_s, monotonic_s()

    first: Any = silent_s()
    site.until(lambda page: (page.of("member_silence_seconds", vehicle=name) or 0.0) > first[1] + 2)
    then: Any = silent_s()
    assert then[0] - first[2] <= then[1] - first[1] <= then[2] - first[0]
