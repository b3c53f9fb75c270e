"""One run of `sim-bridge research bench-fleet`: start everything, let it fly, count.

Members are the companion's own fleet ports and zenoh links around a small state machine. Desks,
stores and routers are the product's own, each a process; all of them share this machine.
"""

import contextlib
import itertools
import math
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa

from companion.adapters.clock import epoch_us, wall_s
from companion.core.base.errors import LeewayError
from ground_station.adapters.pki.pki_folder import MEMBERS
from ground_station.adapters.store import tables
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.schema.orders import OrderRow, OrderState
from sim_bridge.adapters.endpoint import free_tcp_port
from sim_bridge.adapters.postgres_server import postgres_server
from sim_bridge.research.benchmarks.fleet_bench.desk_process import SETTLE_S
from sim_bridge.research.benchmarks.fleet_bench.processes import (
    DESK,
    BenchProcess,
    BenchRouter,
    cpu_s,
    desk_config,
    make_identities,
    member_config,
    rss_mb,
)
from sim_bridge.research.benchmarks.fleet_bench.region import Region

A_PROCESS = 50
MOST_PROCESSES = 40
"""Of members: in a larger fleet each has more than `A_PROCESS` of them."""

LOAD_LIMIT_S = 180.0
"""Until every process has loaded its programs."""

JOIN_LIMIT_S = 180.0
LOOK_S = 2.0
CUT_S = 30.0
POSTGRESQL = "postgresql"
"""As a store: a server of its own, from this machine's programs."""

Figures = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Asked:
    """One run. `order_every_s`: so often each vehicle gets an order. `kill_desk`: each desk is
    killed half way, and another begins on its store at once. `faults`: that, a router killed
    before, and another's members cut off for a time behind. `tls`: with identities, TLS and
    signatures, as `ground-station pki` makes them. `flight_s`: shortest and longest time
    of a member in the air. `states_every_s`: so often each member tells its state; 1 is a
    companion's. `join_apart_s`: between the processes of members; with 0 all of a
    region join at the same moment.
    """

    vehicles: int
    minutes: float
    routers: int = 0
    desks: int = 1
    store: str | None = None
    seed: int = 1
    order_every_s: float = 300.0
    kill_desk: bool = False
    faults: bool = False
    tls: bool = False
    flight_s: tuple[float, float] = (50.0, 70.0)
    states_every_s: float = 1.0
    join_apart_s: float = 0.0


def bench(asked: Asked, tell: Callable[[str], None] = lambda words: None) -> Figures:
    """The figures of one run; `tell` is told how far it is.

    Raises LeewayError where a desk or a member ends by itself.
    """
    if asked.desks > 1 and asked.store not in (None, POSTGRESQL):
        raise LeewayError("--desks: each desk has a store of its own; leave out --store")
    if asked.desks > asked.vehicles:
        raise LeewayError(f"--desks {asked.desks}: expected at most one for each vehicle")
    if asked.tls and asked.routers:
        raise LeewayError("--tls: each desk is called itself; leave out --routers")
    if asked.faults and not asked.routers:
        raise LeewayError("--faults: expected --routers 1 or more, to kill one and to cut one off")
    load_before = os.getloadavg()[0]
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="leeway-bench-")))
        urls = stack.enter_context(_stores(asked, folder))
        workers = stack.enter_context(_killed_at_the_end())
        routers = [BenchRouter(folder, free_tcp_port()) for _ in range(asked.routers)]
        try:
            regions = _regions(asked, folder, urls, [router.port for router in routers], workers)
            figures = _Run(asked, regions, urls, routers, tell).figures(workers)
        finally:
            for router in routers:
                router.process.kill()
    return {
        "vehicles": asked.vehicles,
        "desks": asked.desks,
        "routers": asked.routers,
        "tls": asked.tls,
        "store": sa.make_url(urls[0]).get_backend_name(),
        "order_every_s": asked.order_every_s,
        "states_every_s": asked.states_every_s,
        "join_apart_s": asked.join_apart_s,
        **figures,
        "load_of_machine": [round(load, 1) for load in (load_before, *os.getloadavg()[:2])],
    }


@dataclass(slots=True)
class _Run:
    """Everything has been started, and nobody has joined."""

    asked: Asked
    regions: list[Region]
    urls: list[str]
    routers: list[BenchRouter]
    tell: Callable[[str], None]

    def figures(self, workers: list[BenchProcess]) -> Figures:
        """Let them join and fly, and count."""
        self.tell(f"{len(self._members())} processes of members and {len(self.regions)} desks load")
        self._wait_for_all()
        joins = [self._joined(region) for region in self.regions]
        joined, took_s = sum(here for here, _ in joins), [s for _, s in joins if s is not None]
        joined_s = round(max(took_s), 1) if len(took_s) == len(joins) else None
        self.tell(f"they fly orders for {self.asked.minutes:g} min")
        since_s, size_bytes = wall_s(), self._size_bytes()
        for region in self.regions:
            region.desk.say(f"fly {since_s}")
            region.look()
        before_s = [region.cpu_s for region in self.regions]
        others_before_s = self._others_cpu_s()
        self._fly(since_s, workers)
        flown_s = wall_s() - since_s
        spent = zip(self.regions, before_s, strict=True)
        busy = [(r.cpu_s - s) / flown_s for r, s in spent]
        others = zip(self._others_cpu_s(), others_before_s, strict=True)
        members, routers = ((now_s - then_s) / flown_s for now_s, then_s in others)
        held_mb = sum(map(rss_mb, self._members()))
        grown_mb, hours = (self._size_bytes() - size_bytes) / 1e6, (wall_s() - since_s) / 3600.0
        self.tell("no more orders; what flies lands")
        until_s = wall_s() + 2.0 * SETTLE_S
        for region in self.regions:
            region.assign_no_more()
        for region in self.regions:
            region.settle(until_s)
        flown = Counter(x for region in self.regions for x in region.flown())
        backs = [r.back_s for r in self.regions if r.back_s is not None]
        return {
            **self._acknowledged(),
            ("gone_under_faults" if self.asked.faults else "false_gone"): sum(
                region.gone for region in self.regions
            ),
            "desk_cpu_frac": round(max(busy), 3),
            "desks_cpu_frac": round(sum(busy), 3) if len(busy) > 1 else None,
            "desk_rss_mb": round(max(region.rss_mb for region in self.regions), 1),
            "members_cpu_frac": round(members, 3),
            "members_rss_mb": round(held_mb, 1),
            "routers_cpu_frac": None if self.asked.faults else round(routers, 3),
            "router_rss_mb": max((round(rss_mb(r.process), 1) for r in self.routers), default=None),
            "store_mb_per_hour": round(grown_mb / hours, 1),
            "joined_s": joined_s,
            f"joined_in_{JOIN_LIMIT_S:.0f}_s": joined,
            "present_at_end": sum(region.here for region in self.regions),
            "desk_back_s": round(max(backs), 1) if len(backs) == len(self.regions) else None,
            **self._orders(flown),
        }

    def _wait_for_all(self) -> None:
        """Until every process has loaded."""
        until_s = wall_s() + LOAD_LIMIT_S
        members = self._members()
        for member in members:
            if member.hear(until_s - wall_s()) is None:
                raise LeewayError(f"a process of members did not begin in {LOAD_LIMIT_S:.0f} s")
        for region in self.regions:
            if region.wait("listens", until_s) is None:
                raise LeewayError(f"a desk did not begin within {LOAD_LIMIT_S:.0f} s")

    def _joined(self, region: Region) -> tuple[int, float | None]:
        """Who is there when all members of a region are or time is up, and how long it took from
        the moment at which the last of them began to join.
        """
        for number, member in enumerate(region.members):
            if number:
                region.desk.ends_within(self.asked.join_apart_s)
            member.say("join")
        begun_s = wall_s()
        told = region.wait("whole", begun_s + JOIN_LIMIT_S)
        if told is None:
            self.tell(f"{region.fleet}: not all have joined in {JOIN_LIMIT_S:.0f} s")
            return 0, None
        took_s = told.wall_s - begun_s
        self.tell(f"{region.fleet}: {told.here:,} joined in {took_s:.1f} s")
        return told.here, took_s

    def _others_cpu_s(self) -> tuple[float, float]:
        """What members and routers have taken by now."""
        routers = sum(cpu_s(router.process) for router in self.routers)
        return sum(map(cpu_s, self._members())), routers

    def _members(self) -> list[BenchProcess]:
        return [member for region in self.regions for member in region.members]

    def _fly(self, since_s: float, workers: list[BenchProcess]) -> None:
        long_s = 60.0 * self.asked.minutes
        if self.asked.faults:
            self._watch(since_s + 0.25 * long_s)
            self.routers[0].die()
        if self.asked.faults or self.asked.kill_desk:
            self._watch(since_s + 0.5 * long_s)
            self._kill_desks(since_s, workers)
        if self.asked.faults:
            self._watch(since_s + 0.7 * long_s)
            self.routers[-1].freeze()
            self._watch(wall_s() + min(CUT_S, 0.15 * long_s))
            self.routers[-1].thaw()
        self._watch(since_s + long_s)

    def _kill_desks(self, since_s: float, workers: list[BenchProcess]) -> None:
        killed_s = wall_s()
        for region in self.regions:
            region.kill(since_s)
            workers.append(region.desk)
        for region in self.regions:
            region.wait_back(killed_s, killed_s + JOIN_LIMIT_S)

    def _watch(self, until_s: float) -> None:
        """How much memory the desks take, until then."""
        while (left_s := until_s - wall_s()) > 0.0:
            for region in self.regions:
                region.look()
            self.regions[0].desk.ends_within(min(LOOK_S, left_s))

    def _acknowledged(self) -> Figures:
        """From a command's transaction to its answer's, as the stores have stamped them."""
        asked = tables.commands.c
        rows: list[sa.Row[Any, Any, Any]] = []
        for url in self.urls:
            with _reading(url) as store, store.database.read() as db:
                columns = sa.select(asked.made_us, asked.answered_us, asked.answer)
                rows.extend(db.execute(columns).all())
        took_ms = [(r.answered_us - r.made_us) / 1e3 for r in rows if r.answered_us is not None]
        at = np.percentile(took_ms, [50, 99]).round(1).tolist() if took_ms else (None, None)
        return {
            "ack_ms_p50": at[0],
            "ack_ms_p99": at[1],
            "commands": len(rows),
            "unanswered": sum(row.answer is None for row in rows),
        }

    def _orders(self, flown: Counter[str]) -> dict[str, int]:
        """The members' own count against the stores'; no two desks have an order of one name."""
        orders = Counter(assignment.rpartition(".")[0] for assignment in flown.elements())
        rows: list[OrderRow] = []
        for url in self.urls:
            with _reading(url) as store:
                rows += store.orders()
        known = {row.order.id for row in rows}
        delivered = sum(row.state is OrderState.DELIVERED for row in rows)
        return {
            "orders": len(rows),
            "delivered": delivered,
            "twice": sum(count > 1 for count in orders.values()),
            "lost": len(orders.keys() - known) + max(0, len(orders) - delivered),
        }

    def _size_bytes(self) -> int:
        """SQLite's files (beside each lie at most 4 MB of its journal), or what PostgreSQL says."""
        return sum(map(_size_of, self.urls))


def _size_of(url: str) -> int:
    parsed = sa.make_url(url)
    if parsed.get_backend_name() == "sqlite":
        return Path(parsed.database or "").stat().st_size
    with _reading(url) as store, store.database.read() as db:
        return int(db.execute(sa.select(sa.func.pg_database_size(parsed.database))).scalar_one())


# --- processes and stores -------------------------------------------------------------------------


def _regions(
    asked: Asked,
    folder: Path,
    urls: list[str],
    routers: list[int],
    workers: list[BenchProcess],
) -> list[Region]:
    """Of each region a desk and its members; all of them are noted in `workers`. `routers`: their
    ports.
    """
    regions: list[Region] = []
    each = max(A_PROCESS, math.ceil(asked.vehicles / MOST_PROCESSES))
    router = itertools.cycle(routers)
    for number, (url, share) in enumerate(zip(urls, _shares(asked), strict=True)):
        ports = routers or [free_tcp_port()]
        fleet, homes = f"bench{number}", folder / f"pki{number}"
        if asked.tls:
            make_identities(homes, fleet, [f"v{k}" for k in share], ports[0])
            config = homes / MEMBERS / DESK
        else:
            config = desk_config(folder, number, ports, calls=bool(routers))
        desk = ("desk", fleet, str(len(share)), str(asked.order_every_s), str(config), url)
        regions.append(Region(fleet, len(share), desk, BenchProcess.start(*desk), []))
        workers.append(regions[-1].desk)
        for first in range(share.start, share.stop, each):
            count = min(each, share.stop - first)
            port = next(router, ports[0])
            calls = homes / MEMBERS if asked.tls else member_config(folder, port)
            flown = (str(asked.seed), *map(str, asked.flight_s), str(asked.states_every_s))
            member = BenchProcess.start(
                "members", fleet, str(first), str(count), str(calls), str(folder), *flown
            )
            regions[-1].members.append(member)
            workers.append(member)
    return regions


def _shares(asked: Asked) -> list[range]:
    """Vehicles of each region, by number."""
    ends = [asked.vehicles * k // asked.desks for k in range(asked.desks + 1)]
    return [range(first, end) for first, end in itertools.pairwise(ends)]


@contextlib.contextmanager
def _killed_at_the_end() -> Iterator[list[BenchProcess]]:
    """Whatever happens, no process that was noted here stays."""
    workers: list[BenchProcess] = []
    try:
        yield workers
    finally:
        for worker in workers:
            worker.kill()


@contextlib.contextmanager
def _stores(asked: Asked, folder: Path) -> Iterator[list[str]]:
    """A store for each desk, made before anybody is timed."""
    with contextlib.ExitStack() as stack:
        names = [f"bench{number}" for number in range(asked.desks)]
        if asked.store == POSTGRESQL:
            server = stack.enter_context(postgres_server())
            urls = [server.create_database(name) for name in names]
        else:
            urls = [asked.store or f"sqlite:///{folder / name}.db" for name in names]
        for url in urls:
            with _reading(url) as store:
                if store.orders():
                    raise LeewayError(f"--store {url}: expected an empty store")
        yield urls


@contextlib.contextmanager
def _reading(url: str) -> Iterator[Store]:
    store = Store(Database(url), epoch_us)
    try:
        yield store
    finally:
        store.close()
