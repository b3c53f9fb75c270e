"""Desks that are killed, restarted and restored from older copies, judged by what vehicles did.

The desk is a process; vehicles are `FleetPort`s that fly in threads. Network: zenoh with TLS on
loopback, every message signed. Commands arrive late and out of order.
"""

import contextlib
import dataclasses
import re
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from companion.adapters.clock import wall_s
from companion.adapters.files.params import read_airframe
from companion.app.flight.fleet_port import FleetPort, StoredAssignment
from companion.core.base.errors import LeewayError
from companion.core.mission.events import Mode, VehicleState
from companion.core.pilot.telemetry_state import TelemetryState
from companion.fleet import command_log, member
from companion.fleet.command_log import CommandReply
from companion.fleet.membership import JoinOptions, read_membership
from companion.fleet.messages import (
    Assign,
    Command,
    CommandStatus,
    EventKind,
    Launch,
    Withdraw,
    decode_message,
)
from companion.fleet.network import MemberLink, MemberRequest, RequestKind
from companion.fleet.roles import Role
from companion.fleet.topics import VehicleKeys
from ground_station.adapters.store import restored
from ground_station.adapters.store.copies import back_up_store, restore
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.settle import close_order_with_outcome
from ground_station.app.desk.operator_commands import (
    cancel_order,
    change_order,
    clear_holds,
    take_out_of_service,
)
from ground_station.core.schema.holds import ALL_DRONES
from ground_station.core.schema.order_states import CLOSED, OrderState, ParcelOutcome
from ground_station.core.schema.orders import Order
from tests.fleet.secure_site import YEAR_DAYS, SecureSite
from tests.fleet.zenoh_net import AT_HARBOUR, Vehicle
from tests.ground_station.desk.desk_process import DRONES, SPEED

pytestmark = [pytest.mark.usefixtures("new_epochs"), pytest.mark.timeout(300)]

DESK = Path(__file__).with_name("desk_process.py")
GAP_S = 6.0
PATIENCE_S = 90.0


def now_s() -> float:
    return SPEED * wall_s()


class Truth:
    """What the vehicles did and received."""

    late_frac, max_delay_s = 0.3, 12.0
    """Commands that are late, and their longest delay in the time of the test."""

    flight_s = 6.0, 15.0

    def __init__(self, seed: int) -> None:
        self.lock = threading.Lock()
        self.rng = np.random.default_rng(seed)
        self.take_offs_s: list[float] = []
        self.delivered: Counter[str] = Counter()
        self.carriers: set[str] = set()
        self.content_by_id: dict[str, set[tuple[str, str]]] = {}

    def uniform(self, low: float, high: float) -> float:
        with self.lock:
            return float(self.rng.uniform(low, high))

    def faults(self) -> list[str]:
        gaps = [b - a for a, b in pairwise(sorted(self.take_offs_s))]
        found = [f"take-offs {gap_s:.1f} s apart" for gap_s in gaps if gap_s < GAP_S]
        found += [f"{id_} delivered {n} times" for id_, n in self.delivered.items() if n > 1]
        reused = [id_ for id_, content in self.content_by_id.items() if len(content) > 1]
        return found + [f"{id_} issued twice" for id_ in reused]


class LateLink:
    """A member's link: commands arrive late and out of order; while it `is_cut`, nothing does."""

    def __init__(self, link: MemberLink, truth: Truth) -> None:
        self._link, self._truth = link, truth
        self._late: list[tuple[float, MemberRequest]] = []
        self.cut_until_s = 0.0

    @property
    def is_cut(self) -> bool:
        return now_s() < self.cut_until_s

    def publish_state(self, raw: bytes) -> None:
        if not self.is_cut:
            self._link.publish_state(raw)

    def publish_event(self, raw: bytes) -> None:
        if not self.is_cut:
            self._link.publish_event(raw)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def drain_requests(self) -> list[MemberRequest]:
        for request in self._link.drain_requests():
            if self.is_cut:
                continue
            delay_s = 0.0
            if request.kind is RequestKind.COMMAND:
                self._record(request)
                is_late = self._truth.uniform(0.0, 1.0) < self._truth.late_frac
                delay_s = self._truth.uniform(0.0, self._truth.max_delay_s) if is_late else 0.0
            self._late.append((now_s() + delay_s, request))
        due = sorted((one for one in self._late if one[0] <= now_s()), key=lambda one: one[0])
        self._late = [one for one in self._late if one not in due]
        return [request for _, request in due]

    def _record(self, request: MemberRequest) -> None:
        command = decode_message(Command, request.payload)
        assert isinstance(command, Command)
        with self._truth.lock:
            content = (command.vehicle, repr(command.action))
            self._truth.content_by_id.setdefault(command.id, set()).add(content)


class Flyer(Vehicle):
    """A drone: standby, ready, arm, climb; each flight delivers its order."""

    truth: Truth

    def begin(self, name: str, folder: Path, link_of: Any) -> None:
        self.woken, self._stop = threading.Event(), threading.Event()
        self.phase, self.ends_s, self.is_airborne = "standby", 0.0, False
        self.port = FleetPort.open(
            name, "m100", read_airframe("m100"), folder,
            lambda life: cast(MemberLink, self.late_link(link_of(life))), clock_s=now_s,
        )  # fmt: skip
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def late_link(self, link: MemberLink) -> LateLink:
        self.link = LateLink(link, self.truth)
        return self.link

    def _run(self) -> None:
        while not self._stop.wait(0.02):
            self.port.process_commands(self.carry_out)
            if self.phase in ("arm", "climb") and now_s() >= self.ends_s:
                self._advance()
            height_m = 20.0 if self.is_airborne else 0.0
            position = dataclasses.replace(AT_HARBOUR, height_rel_m=height_m)
            state = VehicleState(0.0, Mode.MISSION, "auto", self.phase in ("arm", "climb"))
            self.port.publish_state_if_due(
                self.phase, TelemetryState(position=position, state=state)
            )

    def _advance(self) -> None:
        truth, here = self.truth, self.port.current
        assert here is not None
        if self.phase == "arm":
            truth.take_offs_s.append(now_s())
            self.phase, self.is_airborne = "climb", True
            self.ends_s = now_s() + truth.uniform(*truth.flight_s)
            return
        truth.delivered[here.order] += 1
        truth.carriers.add(self.port.member.vehicle)
        self._finish("SUC", delivered=True)

    def _finish(self, outcome: str, *, delivered: bool) -> None:
        self.port.record_event(
            EventKind.OUTCOME, "landed", outcome=outcome, delivered=delivered, home=True
        )
        self.port.unload_assignment()
        self.phase, self.is_airborne = "standby", False

    def carry_out(self, command: Command) -> CommandReply:
        action, here = command.action, self.port.current
        loaded = here.assignment if here else None
        match action:
            case Assign() if here is None:
                stored = StoredAssignment(assignment=action.assignment, order=action.order)
                self.port.store_assignment(stored)
                self.phase = "ready"
            case Assign() if action.assignment != loaded:
                return CommandReply(CommandStatus.REFUSED, "busy")
            case Launch() if action.assignment == loaded and self.phase == "ready":
                self.phase, self.ends_s = "arm", now_s() + self.truth.uniform(0.5, 3.0)
            case Launch():
                return CommandReply(CommandStatus.REFUSED, f"in phase {self.phase}")
            case Withdraw() if action.assignment != loaded:
                self.port.member.command_log.prevent_relaunch_of_assignment(action.assignment)
            case Withdraw() if self.phase == "ready":
                self._finish("ABRT", delivered=False)
            case Withdraw():
                return CommandReply(CommandStatus.REFUSED, "in flight")
            case _:
                pass
        return CommandReply(CommandStatus.DONE)


class Site:
    """The desk's process, its store with copies, the drones and a person who settles orders."""

    def __init__(self, folder: Path, url: str, seed: int, orders: int, before: str = "") -> None:
        self.folder, self.url, self.before = folder, url, before
        self.orders = [f"o{n}" for n in range(orders)]
        self.rng, self.truth = np.random.default_rng(seed), Truth(seed)
        self.site = SecureSite(folder / "pki")
        self.site.pki.add_member("d3", Role.VEHICLE, YEAR_DAYS, "")
        Flyer.truth = self.truth
        self.drones = [vehicle_of(self.site, name, folder / name) for name in DRONES]
        store = Store(Database(url), lambda: 1)
        here: dict[str, Any] = {
            "lat_deg": 55.4702, "lon_deg": 8.4460, "alt_amsl_m": 13.0, "mass_kg": 0.4,
        }  # fmt: skip
        store.add_orders_unless_conflict([Order(id=id_, **here) for id_ in self.orders])
        store.close()
        self.copies: list[Path] = []
        self.cancelled: set[str] = set()
        self.copy()
        self.desk = self.start_desk()

    def start_desk(self) -> "subprocess.Popen[bytes]":
        code = f"{self.before}\nimport runpy, sys\nsys.argv = sys.argv[:1] + sys.argv[2:]\n"
        code += f"runpy.run_path({str(DESK)!r}, run_name='__main__')"
        arguments = ["-", self.url, str(self.site.home("desk")), str(GAP_S)]
        with (self.folder / "desk.log").open("ab") as out:
            return subprocess.Popen(
                [sys.executable, "-c", code, *arguments], stdout=out, stderr=subprocess.STDOUT
            )

    def log(self) -> str:
        return (self.folder / "desk.log").read_text(errors="replace")

    def kill_desk(self) -> None:
        self.desk.kill()
        self.desk.wait()

    def copy(self) -> None:
        self.copies.append(self.folder / f"copy{len(self.copies)}")
        back_up_store(self.url, self.copies[-1])

    def restore_older_copy(self, index: int) -> None:
        """Restore a copy; the replaced store is known, or lost. A person releases all at once."""
        self.kill_desk()
        replaced = restored.read_history(self.url) if self.rng.random() < 0.5 else None
        copy = self.copies[index]
        restore(self.url, copy)
        restored.upgrade_and_hold_restored_store(self.url, 1, copy.name, "anna", replaced)
        database = Database(self.url)
        HoldStore(database, lambda: 1).clear_holds([ALL_DRONES], "anna")
        database.close()
        self.desk = self.start_desk()

    def disturb(self) -> None:
        time.sleep(float(self.rng.uniform(2.0, 7.0)))
        match int(self.rng.integers(7)):
            case 0:
                self.kill_desk()
                time.sleep(float(self.rng.uniform(0.0, 2.0)))
                self.desk = self.start_desk()
            case 1:
                self.copy()
            case 2:
                self.cut({str(self.rng.choice(DRONES))}, float(self.rng.uniform(5.0, 60.0)))
            case 3:
                back = bool(self.rng.integers(2))
                self.as_person(
                    lambda store, id_: cancel_order(
                        store, lambda: 1, id_, "anna", "nobody there", to_sender=back
                    )
                )
            case 6:
                broken = str(self.rng.choice(DRONES))
                self.as_person(
                    lambda store, _: take_out_of_service(
                        store, lambda: 1, broken, "motor", "anna", None
                    )
                )
                time.sleep(float(self.rng.uniform(0.0, 4.0)))
                self.as_person(lambda store, _: clear_holds(store, lambda: 1, [broken], "anna"))
            case 4:
                cells = {"lat_deg": f"{self.rng.uniform(55.4700, 55.4704):.7f}", "mass_kg": "0.3"}
                self.as_person(
                    lambda store, id_: change_order(store, lambda: 1, id_, cells, "anna")
                )
            case _:
                self.restore_older_copy(int(self.rng.integers(len(self.copies))))

    def as_person(self, command: Callable[[Store, str], object]) -> None:
        """Give a command for an order drawn, beside the desk; it may be refused."""
        store = Store(Database(self.url), lambda: 1)
        try:
            command(store, str(self.rng.choice(self.orders)))
        except LeewayError:
            pass
        finally:
            store.close()

    def cut(self, names: set[str], duration_s: float) -> None:
        """Cut drones off the network; their flights go on."""
        for drone in self.drones:
            if drone.port.member.vehicle in names:
                drone.link.cut_until_s = now_s() + duration_s

    def restore_first_copy_after_deliveries(self) -> None:
        limit_s = time.monotonic() + PATIENCE_S
        while self.truth.delivered.total() < 2 and time.monotonic() < limit_s:
            time.sleep(0.05)
        self.restore_older_copy(0)

    def complete(self) -> None:
        """Wait until each order is closed; settle by truth what the desk lists."""
        limit_s = time.monotonic() + PATIENCE_S
        store = Store(Database(self.url), lambda: 1)
        try:
            while True:
                rows = store.orders()
                waiting = [r for r in rows if r.state not in CLOSED]
                if not waiting:
                    done = OrderState.DELIVERED
                    self.cancelled = {r.order.id for r in rows if r.state is not done}
                    return
                lines = [line for line in self.log().splitlines() if "order settle" in line]
                for row in waiting:
                    if any(line.endswith(f"order settle {row.order.id}") for line in lines):
                        self.settle(store, row.order.id)
                assert self.desk.poll() is None, self.log()[-3000:]
                if time.monotonic() > limit_s:
                    texts = [f"{r.order.id} {r.state} {r.reason}" for r in waiting]
                    raise AssertionError(f"{texts}\n{self.log()[-3000:]}")
                time.sleep(0.2)
        finally:
            store.close()

    def faults(self) -> list[str]:
        issued = Counter(re.findall(r": assigned \S+ \((\S+)\)", self.log()))
        return self.truth.faults() + [f"{id_} issued again" for id_, n in issued.items() if n > 1]

    def settle(self, store: Store, order: str) -> None:
        vehicles = [drone for drone in self.drones if drone.port.current is not None]
        if any(drone.port.current and drone.port.current.order == order for drone in vehicles):
            return  # the person sees it on its drone
        is_there = self.truth.delivered[order] > 0
        parcel = ParcelOutcome.DELIVERED if is_there else ParcelOutcome.BACK
        close_order_with_outcome(store.database, lambda: 1, order, parcel, "seen", "anna")

    def close(self) -> None:
        self.kill_desk()
        for drone in self.drones:
            drone.close()


def vehicle_of(site: SecureSite, name: str, folder: Path) -> Flyer:
    """Start a drone with its key, on the network of the site."""
    membership = read_membership(VehicleKeys(site.fleet, name), None, JoinOptions(site.home(name)))
    flyer = Flyer.on(name, folder, membership.open_link)
    assert isinstance(flyer, Flyer)
    return flyer


def run(folder: Path, url: str, seed: int, disturbances: int, before: str = "") -> list[str]:
    """Run a day with disturbances; each order is delivered at its end."""
    site = Site(folder, url, seed, 6, before)
    try:
        for _ in range(disturbances):
            site.disturb()
        site.complete()
    finally:
        site.close()
    assert set(site.truth.delivered) == set(site.orders) - site.cancelled
    return site.faults()


def test_safety_rule_7_a_restored_desk_delivers_each_order_once_and_keeps_the_gap(tmp_path):
    site = Site(tmp_path, f"sqlite:///{tmp_path}/desk.db", 1, 4)
    try:
        site.restore_first_copy_after_deliveries()
        site.complete()
    finally:
        site.close()
    assert site.faults() == []
    assert set(site.truth.delivered) == set(site.orders)


@pytest.mark.night
@pytest.mark.parametrize("seed", range(20))
def test_a_desk_killed_and_restored_at_any_moment_delivers_each_order_once(
    tmp_path, store_url, seed
):
    assert run(tmp_path, store_url, seed, 4) == []


PACING = "from ground_station.app.desk.launch_pacing import LaunchPacing as guard\n"
LOST = "from ground_station.adapters.store import restored as guard\n"
HOLDS = "from ground_station.adapters.store import hold_steps as guard\n"
STAMPS = """
from ground_station.adapters.store import launch_store as guard
once = guard._stamp_unanswered_launch
def again(db, id_, window):
    db.exec_driver_sql(f"UPDATE commands SET sent = 0 WHERE id = '{id_}'")
    return once(db, id_, window)
guard._stamp_unanswered_launch = again
"""
REMOVED = {
    "unanswered launches block": f"{PACING}guard._may_still_take_off = lambda pacing, row: False",
    "launches are stamped once": STAMPS,
    "lost outcomes are applied": f"{LOST}guard.is_assignment_of_epochs_root = lambda *given: False",
    "evidence is awaited": f"{HOLDS}guard.hold_after_restore = lambda db: None",
    "validity on board": "",
    "a restore begins an epoch": "",
}


@pytest.mark.night
@pytest.mark.parametrize("guard", REMOVED)
def test_without_one_guard_the_days_fail(tmp_path, monkeypatch, guard):
    if guard == "validity on board":
        for module in (command_log, member):
            monkeypatch.setattr(module, "reply_outside_launch_window", lambda *given: None)
    if guard == "a restore begins an epoch":
        monkeypatch.setattr(restored, "draw_epoch", lambda earlier: earlier[-1])
    for seed in range(3):
        folder = tmp_path / str(seed)
        folder.mkdir()
        if faults_without(guard, folder, seed):
            return
    raise AssertionError(f"no fault without this guard: {guard}")


def faults_without(guard: str, folder: Path, seed: int) -> list[str]:
    """Return what goes wrong with late launches, or after a restore."""
    site = Site(folder, f"sqlite:///{folder}/desk.db", seed, 6, REMOVED[guard])
    try:
        with contextlib.suppress(AssertionError):  # without a guard the day need not end
            if "launches" in guard or "board" in guard:
                site.truth.late_frac, site.truth.max_delay_s = 0.8, 60.0
            else:
                if "epoch" in guard:
                    site.truth.late_frac, site.truth.max_delay_s = 0.8, 20.0
                site.truth.flight_s = 15.0, 30.0
                site.restore_first_copy_after_deliveries()
                if "evidence" in guard:
                    site.cut(site.truth.carriers, 200.0)
            site.complete()
    finally:
        site.close()
    return site.faults()
