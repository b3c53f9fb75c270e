"""Soak test of one companion process over half a day: memory, files and disk usage.

The tested process is `companion run --fleet`, as on a vehicle. This process simulates the world and
a desk that assigns and launches over zenoh. Simulated time runs at maximum speed, so wall-clock
activity of the companion (one state per second) is less frequent per simulated hour.
"""

import itertools
import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import psutil

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import MAX_LAUNCH_VALIDITY_S
from companion.fleet.messages import Assign, Command, CommandAction, Launch, LaunchWindow, State
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import CommandResponse, StateReceived
from sim_bridge.adapters.endpoint import EndpointSet, find_free_tcp_port
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.app.faults.runner import write_changed_flight_file
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.craft_building import FlyOptions, build_single_craft
from sim_bridge.app.flight.stopping import FORCE_EXIT
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.app.trials.fuzz import FLIGHT
from sim_bridge.app.trials.trial import TrialRow, build_row_and_delete_passed_folder
from sim_bridge.app.world.exception_files import count_tracebacks_by_file
from sim_bridge.app.world.vehicle_host import EXCHANGE_S, STEPS_PER_EXCHANGE
from sim_bridge.autopilot.kinds import AUTOPILOTS

FLEET, VEHICLE, AIRFRAME = "soak", "d1", "m100"
ROUTER, MEMBER = "router.json5", "member.json5"
BOOT_LIMIT_S = 60.0
RESPONSE_LIMIT_S = 1.0
"""Reply limit of one exchange. The companion reopens its link between standby and flight; a request
to the old link is lost and is repeated."""

RESEND_INTERVAL_S = 1.0
FLIGHT_LIMIT_S = 300.0
"""Limit from assignment to the next standby; 110 to 170 s without faults."""

SAMPLE_S = 60.0
INITIAL_FLIGHTS = 2
"""Flights until both autopilots' code is loaded and buffers have their final size."""

MAX_MEMORY_MB = 250.0
"""Memory limit, as in docs/results/speed-and-size.md."""

MAX_SLOPE_MB_PER_H = 2.0
"""Memory growth limit at standby: a week of it fits into the smallest Raspberry Pi."""

MAX_MEMORY_INCREASE_MB = 10.0
"""Memory growth limit of short trials: equals the retained telemetry of one flight."""

MIN_SLOPE_DURATION_H = 2.0
MAX_DISK_MB_PER_FLIGHT_H = 100.0
MAX_DISK_MB_PER_H = 1.0
"""Disk limit outside flights: events and commands."""

MAX_EXTRA_FILES = 2
"""Additional open files allowed at standby; zenoh can open one to reconnect."""


class SoakCase(msgspec.Struct, frozen=True, kw_only=True):
    """Duration of the test and interval between assigned flights."""

    seed: int
    hours: float
    flight_interval_min: float = msgspec.field(name="every_minutes")

    @property
    def name(self) -> str:
        """Name of the folder and the case file."""
        return f"soak-seed{self.seed}-{self.hours:g}h"


@dataclass(frozen=True, slots=True)
class SoakSample:
    """Resources of the process; `flights` counts ended flights, `is_standby_without_command` is
    standby.
    """

    t_s: float
    memory_mb: float
    files: int
    threads: int
    disk_mb: float
    flights: int
    is_standby: bool


@dataclass(slots=True)
class SoakDesk:
    """Simulated desk that assigns and launches one flight after another."""

    fleet_link: ZenohFleet
    flight: dict[str, Any]
    state: State | None = None
    _pending_command: tuple[str, CommandAction] | None = None
    _sent_wall_s: float | None = None

    def request_assignment(self, flight_number: int) -> None:
        """Request the assignment of flight `flight_number`."""
        deed = Assign(assignment=f"a{flight_number}", order=f"o{flight_number}", flight=self.flight)
        self._pending_command = (f"assign-{flight_number}", deed)

    def process_events_and_resend_command(self) -> None:
        """Receive events and send the pending command until it is answered."""
        for event in self.fleet_link.receive(0.0):
            if isinstance(event, StateReceived):
                self.state = event.state
            elif isinstance(event, CommandResponse):
                self._advance_pending_command(event)
        if self._pending_command is None or self.state is None:
            return
        if isinstance(self._pending_command[1], Launch) and self.state.phase != "ready":
            return
        if self._sent_wall_s is None or wall_s() - self._sent_wall_s >= RESEND_INTERVAL_S:
            self._sent_wall_s = wall_s()
            command = Command(
                id=self._pending_command[0],
                vehicle=VEHICLE,
                instance_id=self.state.instance_id,
                as_of_s=self.state.uptime_s,
                by="soak",
                action=self._pending_command[1],
            )
            self.fleet_link.send(command, RESEND_INTERVAL_S)

    def _advance_pending_command(self, event: CommandResponse) -> None:
        if (
            self._pending_command is None
            or event.command_id != self._pending_command[0]
            or event.result is None
        ):
            return
        deed, result_status = self._pending_command[1], event.result.status.value
        if result_status == "expired" or (result_status == "done" and isinstance(deed, Assign)):
            self._pending_command = self._launch_within_window(deed)
        elif result_status == "done":
            self._pending_command = None
        elif result_status == "refused":
            raise LeewayError(f"soak: command {event.command_id} refused: {event.result.reason}")

    def _launch_within_window(self, deed: CommandAction) -> tuple[str, Launch]:
        assert self.state is not None
        assert isinstance(deed, Assign | Launch)
        uptime_s = self.state.uptime_s
        window = LaunchWindow(
            instance_id=self.state.instance_id,
            not_before_s=uptime_s,
            expires_s=uptime_s + MAX_LAUNCH_VALIDITY_S,
        )
        id_ = f"launch-{deed.assignment}-{uptime_s:.1f}"
        return id_, Launch(assignment=deed.assignment, window=window)

    def is_standby_without_command(self) -> bool:
        """Return True if no command is pending and the vehicle reports standby."""
        known = self.state is not None and self.state.phase == "standby"
        return known and self._pending_command is None


@dataclass(slots=True)
class Soak:
    """The simulated world of one companion process."""

    case: SoakCase
    folder: Path
    endpoints: EndpointSet
    companion: CompanionProcess
    desk: SoakDesk
    flight_file: Path
    samples: list[SoakSample] = field(default_factory=list)
    flight_ends: list[str] = field(default_factory=list)
    t_s: float = 0.0
    _craft: Craft | None = None
    _lockstep: Lockstep | None = None

    def run_until_limit_or_fault(self) -> str:
        """Run until the time limit. Return the first fault, else an empty string."""
        end_s = 3600.0 * self.case.hours
        for number in itertools.count(1):
            start_s = self.t_s
            self._power_up_new_vehicle(number)
            self.desk.request_assignment(number)
            while not self._has_landed_and_is_standby():
                if not self.companion.is_running:
                    return f"the companion exited with {self.companion.exit_code}"
                if self.t_s - start_s > FLIGHT_LIMIT_S:
                    return f"flight {number} did not end within {FLIGHT_LIMIT_S:g} s"
                self._advance_one_exchange()
            self.flight_ends.append("down")
            until_s = min(start_s + 60.0 * self.case.flight_interval_min, end_s)
            while self.t_s < until_s - 1e-6:
                self._advance_one_exchange()
            self._append_resource_sample()
            if self.t_s >= end_s - 1e-6:
                return ""
        return ""

    def _power_up_new_vehicle(self, flight_number: int) -> None:
        """Start a flight with a new battery: the autopilot boots, the companion keeps running."""
        options = FlyOptions(
            flight_file=self.flight_file,
            autopilot=AUTOPILOTS[flight_number % 2],
            seed=self.case.seed + flight_number,
            picture=False,
        )
        folder = self.folder / "world"
        folder.mkdir(exist_ok=True)
        craft = build_single_craft(options, "fleet", folder)
        craft.operator.authorises = False
        craft.companion = self.companion
        first = self._lockstep is None
        self._lockstep = Lockstep(
            self.endpoints,
            [0],
            lambda _, t_ns: craft.link.take_datagrams_for_companion(t_ns),
            limit_s=RESPONSE_LIMIT_S,
            is_alive=lambda _: self.companion.is_running,
        )
        self._craft = craft
        if self._lockstep.wait_until_clients_respond(1, BOOT_LIMIT_S).timed_out:
            when = "start" if first else "reply at standby"
            raise LeewayError(
                f"soak: the companion did not {when}: {self.companion.last_output_lines()}"
            )

    def _has_landed_and_is_standby(self) -> bool:
        assert self._craft is not None
        down = self._craft.record.landed_s is not None
        return down and self.desk.is_standby_without_command()

    def _advance_one_exchange(self) -> None:
        craft, lockstep = self._craft, self._lockstep
        assert craft is not None
        assert lockstep is not None
        self.t_s += EXCHANGE_S
        craft.advance_and_deliver_frames(STEPS_PER_EXCHANGE)
        t_ns = round(craft.t_s * 1e9)
        exchanged = lockstep.exchange_one_step(t_ns)
        received = exchanged.received
        if exchanged.timed_out and self.companion.is_running:
            received = received + lockstep.wait_until_clients_respond(t_ns, BOOT_LIMIT_S).received
        for _, datagram in received:
            craft.link.pass_datagram_to_autopilot(datagram)
        self.desk.process_events_and_resend_command()
        if not self.samples or self.t_s - self.samples[-1].t_s >= SAMPLE_S:
            self._append_resource_sample()

    def _append_resource_sample(self) -> None:
        pid = self.companion.pid
        if pid is None:
            return
        process, files = psutil.Process(pid), self.companion.run_dir.rglob("*")
        self.samples.append(
            SoakSample(
                t_s=self.t_s,
                memory_mb=process.memory_info().rss / 1e6,
                files=process.num_fds(),
                threads=process.num_threads(),
                disk_mb=sum(path.stat().st_size for path in files if path.is_file()) / 1e6,
                flights=len(self.flight_ends),
                is_standby=self.desk.is_standby_without_command(),
            )
        )


def run_case(case: SoakCase, folder: Path) -> TrialRow:
    """Run the soak test and evaluate it; the row has the figures of the samples."""
    FORCE_EXIT.set()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    _write_zenoh_configurations(folder)
    flight_file = write_changed_flight_file(folder / "flight.toml", FLIGHT)
    fleet_link = ZenohFleet(FLEET, folder / ROUTER)
    endpoints = EndpointSet(["udpin:127.0.0.1:0"])
    companion = CompanionProcess(
        run_dir=folder / VEHICLE,
        arguments=[
            f"--link=udpout:127.0.0.1:{endpoints.urls[0].rsplit(':', 1)[1]}",
            f"--airframe={AIRFRAME}",
            f"--fleet={FLEET}",
            f"--vehicle={VEHICLE}",
            f"--zenoh={folder / MEMBER}",
            "--configure",
        ],
    )
    flight = msgspec.toml.decode(flight_file.read_bytes())
    flight.pop("wind", None)  # a desk does not know the true wind
    desk = SoakDesk(fleet_link, flight)
    soak = Soak(case, folder, endpoints, companion, desk, flight_file)
    try:
        companion.start()
        violation = soak.run_until_limit_or_fault()
    finally:
        companion.terminate_or_kill()
        endpoints.close()
        fleet_link.close()
    violation = (
        violation
        or ("an exception" if count_tracebacks_by_file(companion.run_dir) else "")
        or describe_exceeded_limits(soak.samples, case.hours)
    )
    return build_row_and_delete_passed_folder(
        case,
        folder,
        [violation] if violation else [],
        summarize_resource_samples(soak.samples, case.hours),
    )


def _write_zenoh_configurations(folder: Path) -> None:
    """Write the zenoh configurations of a router on loopback and of its client."""
    ends = [f"tcp/127.0.0.1:{find_free_tcp_port()}"]
    no_multicast = {"scouting": {"multicast": {"enabled": False}}}
    retry = {"period_init_ms": 50, "period_max_ms": 500}
    files = {
        ROUTER: {"mode": "router", "listen": {"endpoints": ends}},
        MEMBER: {"mode": "client", "connect": {"endpoints": ends, "retry": retry}},
    }
    for name, table in files.items():
        (folder / name).write_text(json.dumps(no_multicast | table))


def standby_samples_after_warm_up(samples: list[SoakSample]) -> list[SoakSample]:
    """Return the samples at standby after the first WARM_FLIGHTS flights."""
    return [sample for sample in samples if sample.is_standby and sample.flights >= INITIAL_FLIGHTS]


def summarize_resource_samples(samples: list[SoakSample], trial_hours: float) -> dict[str, Any]:
    """Return the rounded figures for the report."""
    standby = standby_samples_after_warm_up(samples)
    if len(standby) < 2:
        return {"flights": samples[-1].flights if samples else 0}
    last = samples[-1]
    return {
        "hours": round(last.t_s / 3600.0, 3),
        "flights": last.flights,
        "memory_mb": round(max(sample.memory_mb for sample in samples), 1),
        "growth_mb": round(standby[-1].memory_mb - standby[0].memory_mb, 2),
        "slope_mb_per_h": round(memory_slope_mb_per_h(standby), 3)
        if trial_hours >= MIN_SLOPE_DURATION_H
        else None,
        "files": [standby[0].files, standby[-1].files],
        "threads": [standby[0].threads, standby[-1].threads],
        "disk_mb_per_flight": round(last.disk_mb / max(last.flights, 1), 2),
    }


def memory_slope_mb_per_h(samples: list[SoakSample]) -> float:
    """Return the memory growth in MB per hour, by least squares."""
    times_h = np.array([sample.t_s for sample in samples]) / 3600.0
    return float(np.polyfit(times_h, [sample.memory_mb for sample in samples], 1)[0])


def describe_exceeded_limits(samples: list[SoakSample], trial_hours: float) -> str:
    """Return the exceeded limits, empty if all are met."""
    standby = standby_samples_after_warm_up(samples)
    if len(standby) < 2:
        return f"only {samples[-1].flights if samples else 0} flights: too few for an evaluation"
    first, last = standby[0], standby[-1]
    peak_mb = max(sample.memory_mb for sample in samples)
    is_short = trial_hours < MIN_SLOPE_DURATION_H
    slope = 0.0 if is_short else memory_slope_mb_per_h(standby)
    is_grown = is_short and last.memory_mb - first.memory_mb > MAX_MEMORY_INCREASE_MB
    max_disk_mb = (
        last.flights * FLIGHT_LIMIT_S / 3600.0 * MAX_DISK_MB_PER_FLIGHT_H
        + last.t_s / 3600.0 * MAX_DISK_MB_PER_H
    )
    limits = (
        (peak_mb > MAX_MEMORY_MB, f"{peak_mb:.0f} MB of memory"),
        (is_grown, f"memory grew from {first.memory_mb:.1f} to {last.memory_mb:.1f} MB"),
        (slope > MAX_SLOPE_MB_PER_H, f"memory grows by {slope:.2f} MB/h"),
        (
            last.files > first.files + MAX_EXTRA_FILES,
            f"{last.files} open files after {first.files}",
        ),
        (last.threads > first.threads, f"{last.threads} threads after {first.threads}"),
        (
            last.disk_mb > max_disk_mb,
            f"{last.disk_mb:.0f} MB on disk after {last.flights} flights",
        ),
    )
    return "; ".join(violation for is_exceeded, violation in limits if is_exceeded)
