"""A region of the benchmark: one desk with its store and its members."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.clock import unix_time_us, wall_s
from companion.core.base.errors import LeewayError
from companion.fleet.roles import Role
from ground_station.adapters.pki.pki_folder import MEMBERS_FOLDER, PkiFolder, utc_datetime
from sim_bridge.adapters.endpoint import find_free_tcp_port
from sim_bridge.research.benchmarks.fleet_bench.desk_process import DeskLine
from sim_bridge.research.benchmarks.fleet_bench.hostile import HOSTILE
from sim_bridge.research.benchmarks.fleet_bench.processes import (
    BenchProcess,
    write_desk_config,
    write_member_config,
)

DESK = "desk"
VALID_DAYS = 365
LOAD_LIMIT_S = 180.0
"""Timeout for all processes to load their modules."""

JOIN_LIMIT_S = 180.0


@dataclass(slots=True)
class Region:
    """One desk and its members. `cpu_s`, `rss_mb` (maximum): of the desk's processes at the last
    sample. `recovery_s`: time from a desk's death until its successor receives every member's
    state; None if it did not die, or on timeout.
    """

    fleet: str
    vehicles: range
    desk_arguments: dict[str, Any]
    desk: BenchProcess
    port: int
    members: list[BenchProcess] = field(default_factory=list)
    cpu_s: float = 0.0
    rss_mb: float = 0.0
    recovery_s: float | None = None
    false_departures: int = 0
    present: int = 0
    _before_s: float = 0.0

    @classmethod
    def start(
        cls,
        fleet: str,
        vehicles: range,
        folder: Path,
        router_ports: list[int],
        next_router_port: Iterator[int],
        *,
        uses_identities: bool,
        members_per_process: int,
        desk: dict[str, Any],
        member: dict[str, Any],
    ) -> "Region":
        """Start the desk and its members, with or without routers and identities.

        `next_router_port`: router of the next member process. `desk`, `member`: further arguments
        of their processes.
        """
        ports = router_ports or [find_free_tcp_port()]
        configs = folder / fleet / MEMBERS_FOLDER
        if uses_identities:
            pki = PkiFolder.create_fleet(folder / fleet, fleet, utc_datetime(unix_time_us()))
            pki.add_member(DESK, Role.DESK, VALID_DAYS, f"127.0.0.1:{ports[0]}")
            names = [*(f"v{number}" for number in vehicles), HOSTILE]
            pki.add_members(names, Role.VEHICLE, VALID_DAYS)
            config = configs / DESK
        else:
            config = write_desk_config(
                folder / f"{fleet}.json5", ports, connects_to_routers=bool(router_ports)
            )
        arguments = desk | {"fleet": fleet, "vehicle_count": len(vehicles), "config": config}
        region = cls(fleet, vehicles, arguments, BenchProcess.start("desk", **arguments), ports[0])
        for first in vehicles[::members_per_process]:
            port = next(next_router_port, ports[0])
            process = BenchProcess.start(
                "members",
                fleet=fleet,
                first=first,
                count=min(members_per_process, vehicles.stop - first),
                config=configs if uses_identities else write_member_config(folder, port),
                folder=folder,
                **member,
            )
            region.members.append(process)
        return region

    def kill(self) -> None:
        """Kill all processes."""
        for process in (self.desk, *self.members):
            process.kill()

    def wait_until_loaded(self, until_s: float) -> None:
        """Wait until every process has loaded. Raises LeewayError on timeout."""
        for member in self.members:
            if member.read_line(until_s - wall_s()) is None:
                raise LeewayError(f"a member process did not start within {LOAD_LIMIT_S:.0f} s")
        if self.wait_for_line("listens", until_s) is None:
            raise LeewayError(f"a desk did not start within {LOAD_LIMIT_S:.0f} s")

    def join_members(
        self, join_delay_s: float, report_progress: Callable[[str], None]
    ) -> tuple[int, float | None]:
        """Return the members present when all have joined or on timeout, and the time since the
        last of them started to join (None on timeout).
        """
        for number, member in enumerate(self.members):
            if number:
                self.desk.wait_for_exit(join_delay_s)
            member.write_line("join")
        begun_s = wall_s()
        whole = self.wait_for_line("whole", begun_s + JOIN_LIMIT_S)
        if whole is None:
            report_progress(f"{self.fleet}: not all members joined within {JOIN_LIMIT_S:.0f} s")
            return 0, None
        join_time_s = whole.wall_s - begun_s
        report_progress(f"{self.fleet}: {whole.present:,} joined in {join_time_s:.1f} s")
        return whole.present, join_time_s

    def record_desk_usage(self) -> None:
        """Sample CPU time and memory of the desk."""
        self._raise_if_desk_exited()
        self.cpu_s = self._before_s + self.desk.cpu_time_s
        self.rss_mb = max(self.rss_mb, self.desk.rss_mb)

    def _raise_if_desk_exited(self) -> None:
        if self.desk.process.poll() is not None:
            raise LeewayError(f"the desk of {self.fleet} exited unexpectedly")

    def wait_for_line(self, kind: str, until_s: float) -> DeskLine | None:
        """Return the desk's line of this kind; None on timeout."""
        while (line := self.desk.read_line(until_s - wall_s())) is not None:
            desk_line = msgspec.json.decode(line, type=DeskLine)
            if desk_line.kind == kind:
                return desk_line
        self._raise_if_desk_exited()
        return None

    def kill_and_restart_desk(self, order_start_s: float) -> None:
        """Kill the desk as in a power cut; start a successor on its store."""
        self.record_desk_usage()
        self._before_s = self.cpu_s
        self.desk.kill()
        self.desk = BenchProcess.start("desk", **self.desk_arguments)
        self.desk.write_line(f"fly {order_start_s}")

    def wait_until_landed(self, until_s: float) -> None:
        """Wait until all members have landed."""
        ended = self.wait_for_line("ended", until_s)
        if ended is not None:
            self.present, self.false_departures = ended.present, ended.false_departures

    def stop_members_read_flown_assignments(self) -> list[str]:
        """End the member processes; return the assignments that they report as flown."""
        flown: list[str] = []
        for member in self.members:
            words = member.close_input_and_read_last_line()
            if not words.startswith("["):
                raise LeewayError("a member process exited unexpectedly or did not stop")
            flown += msgspec.json.decode(words, type=list[str])
        return flown
