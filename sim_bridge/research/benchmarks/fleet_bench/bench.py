"""One run of `sim-bridge research bench-fleet`: start all processes, fly, collect results.

Members use the companion's fleet ports and zenoh links around a small state machine. Desks, stores
and routers are the product's, each a separate process; all share one machine.
"""

import contextlib
import itertools
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa

from companion.adapters.clock import unix_time_us, wall_s
from companion.core.base.errors import LeewayError
from ground_station.adapters.store import tables
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.schema.orders import OrderRow, OrderState
from sim_bridge.adapters.endpoint import find_free_tcp_port
from sim_bridge.research.benchmarks.fleet_bench.desk_process import LANDING_TIMEOUT_S
from sim_bridge.research.benchmarks.fleet_bench.hostile import HOSTILE
from sim_bridge.research.benchmarks.fleet_bench.processes import BenchProcess, start_router
from sim_bridge.research.benchmarks.fleet_bench.region import JOIN_LIMIT_S, LOAD_LIMIT_S, Region
from sim_bridge.research.study.run import Report
from sim_bridge.research.study.sheet import Sheet

MEMBERS_PER_PROCESS = 50
MAX_PROCESSES = 40
"""Maximum member processes; in a larger fleet each runs more than `MEMBERS_PER_PROCESS` members."""

SAMPLE_INTERVAL_S = 2.0

Results = dict[str, Any]


@dataclass(frozen=True, slots=True)
class BenchRequest:
    """Options of one run. `order_interval_s`: interval between orders per vehicle. `kill_desk`:
    each desk is killed halfway, and a successor starts on its store immediately. `tls`: use
    identities, TLS and signatures as created by `ground-station pki`. `flight_s`: shortest and
    longest flight time of a member. `state_interval_s`: interval between states of a member; a
    companion uses 1. `join_delay_s`: delay between joins of member processes; with 0 all members
    of a region join at the same time. `hostile_messages`: a member of the first region floods its
    own key with so many, beside a thousandth as many idle connections; requires `tls`.
    """

    vehicles: int
    minutes: float
    routers: int = 0
    desks: int = 1
    store: str | None = None
    seed: int = 1
    order_interval_s: float = 300.0
    kill_desk: bool = False
    tls: bool = False
    flight_s: tuple[float, float] = (50.0, 70.0)
    state_interval_s: float = 1.0
    join_delay_s: float = 0.0
    hostile_messages: int = 0


def build_fleet_benchmark_report(results: Results) -> Report:
    """Return the results as a table and as the JSON document."""
    cells = [[name, "" if value is None else str(value)] for name, value in results.items()]
    note = "The keys of the JSON document; ms: of a command, from request to response."
    return Report({"bench_fleet": Sheet("Fleet", ["what", "figure"], cells, note)}, results)


def run_fleet_benchmark(
    request: BenchRequest, report_progress: Callable[[str], None] = lambda words: None
) -> Results:
    """Return the results of one run; `report_progress` receives progress messages.

    Raises LeewayError if a desk or member process exits unexpectedly.
    """
    if request.desks > 1 and request.store is not None:
        raise LeewayError("--desks: each desk has a store of its own; leave out --store")
    if request.desks > request.vehicles:
        raise LeewayError(f"--desks {request.desks}: expected at most one for each vehicle")
    if request.tls and request.routers:
        raise LeewayError("--tls: members connect to desks directly; leave out --routers")
    if request.hostile_messages and not request.tls:
        raise LeewayError("--hostile: its messages are signed; add --tls")
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="leeway-bench-")))
        urls = _create_empty_store_urls(request, folder)
        ports = [find_free_tcp_port() for _ in range(request.routers)]
        for port in ports:
            stack.callback(start_router(folder, port).kill)
        regions, next_port = list[Region](), itertools.cycle(ports)
        for number, url in enumerate(urls):
            regions.append(_start_region(request, number, url, folder, ports, next_port))
            stack.callback(regions[-1].kill)
        results = _BenchRun(request, regions, urls, report_progress).run_join_and_flight_phases()
    return {
        "vehicles": request.vehicles,
        "desks": request.desks,
        "routers": request.routers,
        "tls": request.tls,
        "store": sa.make_url(urls[0]).get_backend_name(),
        "order_every_s": request.order_interval_s,
        "states_every_s": request.state_interval_s,
        "join_apart_s": request.join_delay_s,
        "hostile_messages": request.hostile_messages or None,
        **results,
    }


def _start_region(
    request: BenchRequest,
    number: int,
    url: str,
    folder: Path,
    router_ports: list[int],
    next_router_port: Iterator[int],
) -> Region:
    first, end = (request.vehicles * k // request.desks for k in (number, number + 1))
    each = max(MEMBERS_PER_PROCESS, math.ceil(request.vehicles / MAX_PROCESSES))
    return Region.start(
        f"bench{number}",
        range(first, end),
        folder,
        router_ports,
        next_router_port,
        uses_identities=request.tls,
        members_per_process=each,
        desk={"order_interval_s": request.order_interval_s, "store_url": url},
        member={
            "seed": request.seed,
            "flight_s": request.flight_s,
            "state_interval_s": request.state_interval_s,
        },
    )


@dataclass(slots=True)
class _BenchRun:
    """A run whose processes have started, before any member joins."""

    request: BenchRequest
    regions: list[Region]
    urls: list[str]
    report_progress: Callable[[str], None]

    def run_join_and_flight_phases(self) -> Results:
        """Run joining and flight phases and return the results."""
        processes = sum(len(region.members) for region in self.regions)
        self.report_progress(f"{processes} member processes and {len(self.regions)} desks load")
        until_s = wall_s() + LOAD_LIMIT_S
        for region in self.regions:
            region.wait_until_loaded(until_s)
        joins = [
            region.join_members(self.request.join_delay_s, self.report_progress)
            for region in self.regions
        ]
        join_times_s = [time_s for _, time_s in joins if time_s is not None]
        self.report_progress(f"members fly orders for {self.request.minutes:g} min")
        hostile = self._start_hostile_member()
        since_s, size_bytes = wall_s(), sum(map(_store_size_bytes, self.urls))
        for region in self.regions:
            region.desk.write_line(f"fly {since_s}")
            region.record_desk_usage()
        before_s = [region.cpu_s for region in self.regions]
        members_before_s = self._members_cpu_s()
        self._wait_through_flight_phase(since_s)
        flown_s = wall_s() - since_s
        desk_loads = [
            (region.cpu_s - cpu_s) / flown_s
            for region, cpu_s in zip(self.regions, before_s, strict=True)
        ]
        members_load = (self._members_cpu_s() - members_before_s) / flown_s
        store_increase_mb = (sum(map(_store_size_bytes, self.urls)) - size_bytes) / 1e6
        hours = (wall_s() - since_s) / 3600.0
        if hostile is not None:
            words = hostile.read_line(0.0)
            self.report_progress(f"hostile messages, s: {words or 'not all sent'}")
            hostile.kill()
        self.report_progress("no more orders; airborne members land")
        until_s = wall_s() + 2.0 * LANDING_TIMEOUT_S
        for region in self.regions:
            region.desk.write_line("stop")  # no more orders; airborne members land
            region.record_desk_usage()
        for region in self.regions:
            region.wait_until_landed(until_s)
        flown = [x for region in self.regions for x in region.stop_members_read_flown_assignments()]
        backs = [r.recovery_s for r in self.regions if r.recovery_s is not None]
        return {
            **self._command_response_time_statistics(),
            "false_gone": sum(region.false_departures for region in self.regions),
            "desk_cpu_frac": round(max(desk_loads), 3),
            "desks_cpu_frac": round(sum(desk_loads), 3) if len(desk_loads) > 1 else None,
            "desk_rss_mb": round(max(region.rss_mb for region in self.regions), 1),
            "members_cpu_frac": round(members_load, 3),
            "store_mb_per_hour": round(store_increase_mb / hours, 1),
            "joined_s": _max_of_all_or_none(join_times_s, len(joins)),
            f"joined_in_{JOIN_LIMIT_S:.0f}_s": sum(present for present, _ in joins),
            "present_at_end": sum(region.present for region in self.regions),
            "desk_back_s": _max_of_all_or_none(backs, len(self.regions)),
            **self._compare_flown_and_stored_orders(flown),
        }

    def _start_hostile_member(self) -> BenchProcess | None:
        count, region = self.request.hostile_messages, self.regions[0]
        if not count:
            return None
        return BenchProcess.start(
            "hostile",
            fleet=region.fleet,
            config=Path(region.desk_arguments["config"]).with_name(HOSTILE),
            port=region.port,
            messages=count,
            connections=count // 1000,
        )

    def _members_cpu_s(self) -> float:
        """Return the CPU time used by all member processes."""
        return sum(member.cpu_time_s for region in self.regions for member in region.members)

    def _wait_through_flight_phase(self, since_s: float) -> None:
        long_s = 60.0 * self.request.minutes
        if self.request.kill_desk:
            self._sample_desk_usage_until(since_s + 0.5 * long_s)
            killed_s = wall_s()
            for region in self.regions:
                region.kill_and_restart_desk(since_s)
            for region in self.regions:
                whole = region.wait_for_line("whole", killed_s + JOIN_LIMIT_S)
                region.recovery_s = None if whole is None else whole.wall_s - killed_s
        self._sample_desk_usage_until(since_s + long_s)

    def _sample_desk_usage_until(self, until_s: float) -> None:
        """Sample CPU time and memory of the desks until `until_s`."""
        while (left_s := until_s - wall_s()) > 0.0:
            for region in self.regions:
                region.record_desk_usage()
            self.regions[0].desk.wait_for_exit(min(SAMPLE_INTERVAL_S, left_s))

    def _command_response_time_statistics(self) -> Results:
        """Return the time from command to response, from the timestamps in the stores."""
        request = tables.commands.c
        rows: list[sa.Row[Any, Any, Any]] = []
        for url in self.urls:
            with _open_store(url) as store, store.database.read() as db:
                columns = sa.select(request.made_us, request.answered_us, request.answer)
                rows.extend(db.execute(columns).all())
        response_ms = [(r.answered_us - r.made_us) / 1e3 for r in rows if r.answered_us is not None]
        at = np.percentile(response_ms, [50, 99]).round(1).tolist() if response_ms else (None, None)
        return {
            "ack_ms_p50": at[0],
            "ack_ms_p99": at[1],
            "commands": len(rows),
            "unanswered": sum(row.answer is None for row in rows),
        }

    def _compare_flown_and_stored_orders(self, flown_assignments: list[str]) -> dict[str, int]:
        """Compare flown orders with the stores' records; order names are unique over all desks."""
        orders = Counter(id_.rsplit(".", 2)[0] for id_ in flown_assignments)  # order, epoch, number
        rows: list[OrderRow] = []
        for url in self.urls:
            with _open_store(url) as store:
                rows += store.orders()
        known = {row.order.id for row in rows}
        delivered = sum(row.state is OrderState.DELIVERED for row in rows)
        return {
            "orders": len(rows),
            "delivered": delivered,
            "twice": sum(count > 1 for count in orders.values()),
            "lost": len(orders.keys() - known) + max(0, len(orders) - delivered),
        }


def _max_of_all_or_none(values_s: list[float], count: int) -> float | None:
    """Return the largest value, rounded; None if one of `count` is missing."""
    return round(max(values_s), 1) if len(values_s) == count else None


def _store_size_bytes(database_url: str) -> int:
    """Return the size of an SQLite file (without journals) or a PostgreSQL database."""
    parsed = sa.make_url(database_url)
    if parsed.get_backend_name() == "sqlite":
        return Path(parsed.database or "").stat().st_size
    with _open_store(database_url) as store, store.database.read() as db:
        return int(db.execute(sa.select(sa.func.pg_database_size(parsed.database))).scalar_one())


def _create_empty_store_urls(request: BenchRequest, folder: Path) -> list[str]:
    """Create a store for each desk before timing starts."""
    urls = [
        request.store or f"sqlite:///{folder / f'bench{number}'}.db"
        for number in range(request.desks)
    ]
    for url in urls:
        with _open_store(url) as store:
            if store.orders():
                raise LeewayError(f"--store {url}: expected an empty store")
    return urls


def _open_store(url: str) -> contextlib.closing[Store]:
    return contextlib.closing(Store(Database(url), unix_time_us))
