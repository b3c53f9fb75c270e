"""Processes of one run: routers, members and desks, each a Python interpreter."""

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from companion.fleet.zenoh_config import LEASE_MS, RECONNECT_MS
from ground_station.adapters.pki.access_rules import CONNECTION_LIMITS
from sim_bridge.adapters.lifeline import code_tied_to_parent_process

ROLES = {"members": "members", "desk": "desk_process", "router": "processes", "hostile": "hostile"}
"""Module of each role, with a function `run_ROLE` that never returns."""

QUIET = {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}
LEASE = {"link": {"tx": {"lease": LEASE_MS}}}
"""Lease as in the network files that `pki` creates."""

STOP_S = 120.0
"""Timeout for a process to exit after a stop request; then it is killed."""


@dataclass(slots=True)
class BenchProcess:
    """Child process with line-based standard input and output; a thread reads its output."""

    process: "subprocess.Popen[str]"
    output_lines: "queue.SimpleQueue[str | None]" = field(default_factory=queue.SimpleQueue)

    @classmethod
    def start(cls, role: str, **arguments: Any) -> "BenchProcess":
        """Start a process of this role."""
        load = f"import json, sys; from {__package__}.{ROLES[role]} import run_{role}"
        code = code_tied_to_parent_process(f"{load}; run_{role}(**json.loads(sys.argv[1]))")
        process = subprocess.Popen(
            [sys.executable, "-c", code, json.dumps(arguments, default=str)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )
        worker = cls(process)
        threading.Thread(target=worker._queue_output_lines, daemon=True).start()
        return worker

    def _queue_output_lines(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.output_lines.put(line)
        self.output_lines.put(None)

    def write_line(self, line: str) -> None:
        """Write a line to the process."""
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def read_line(self, limit_s: float) -> str | None:
        """Return the next output line; None on timeout or if the process has ended."""
        try:
            return self.output_lines.get(timeout=max(0.0, limit_s))
        except queue.Empty:
            return None

    def wait_for_exit(self, limit_s: float) -> None:
        """Wait for the process to exit, or for this time."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(limit_s)

    def close_input_and_read_last_line(self) -> str:
        """Close standard input and return the last output line."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        words = ""
        while (line := self.read_line(STOP_S)) is not None:
            words = line
        return words

    def kill(self) -> None:
        """Kill the process and close its pipes."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()

    @property
    def cpu_time_s(self) -> float:
        """CPU time that the process has used."""
        process_times = psutil.Process(self.process.pid).cpu_times()
        return process_times.user + process_times.system

    @property
    def rss_mb(self) -> float:
        """Resident memory of the process."""
        return psutil.Process(self.process.pid).memory_info().rss / 1e6


def write_member_config(folder: Path, port: int) -> Path:
    """Write the configuration of a client that retries connections, as `pki` configures it."""
    retry = {"period_init_ms": 200, "period_max_ms": RECONNECT_MS}
    call = {"endpoints": [f"tcp/127.0.0.1:{port}"], "exit_on_failure": False, "timeout_ms": 0}
    table = {"mode": "client", "connect": call | {"retry": retry}}
    return _write_zenoh_config(folder / f"member-{port}.json5", table, {})


def write_desk_config(path: Path, ports: list[int], *, connects_to_routers: bool) -> Path:
    """Write a desk configuration that connects to every router, or listens for members."""
    ends = {"endpoints": [f"tcp/127.0.0.1:{port}" for port in ports]}
    endpoints = {"connect": ends, "listen": {"endpoints": []}}
    table = {"mode": "peer", **(endpoints if connects_to_routers else {"listen": ends})}
    return _write_zenoh_config(path, table, CONNECTION_LIMITS)


def start_router(folder: Path, port: int) -> BenchProcess:
    """Start a router of the zenoh Python binding."""
    table = {"mode": "router", "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    config = _write_zenoh_config(folder / f"router-{port}.json5", table, CONNECTION_LIMITS)
    return BenchProcess.start("router", config=config)


def _write_zenoh_config(path: Path, table: dict[str, Any], unicast: dict[str, Any]) -> Path:
    """Write a zenoh configuration without scouting."""
    transport = LEASE | ({"unicast": unicast} if unicast else {})
    path.write_text(json.dumps(QUIET | table | {"transport": transport}))
    return path


def run_router(config: str) -> None:
    """Run zenoh's router until standard input ends."""
    import zenoh

    from companion.fleet.zenoh_config import read_and_check_zenoh_config

    with zenoh.open(read_and_check_zenoh_config(Path(config))):
        sys.stdin.read()
    os._exit(0)
