"""The processes of one run: routers, members and desks, each a Python of its own."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from companion.adapters.clock import epoch_us
from companion.fleet.roles import Role
from companion.fleet.zenoh_config import CALL_AGAIN_MS, LEASE_MS
from ground_station.adapters.pki.access_rules import MANY_CALLERS
from ground_station.adapters.pki.pki_folder import PkiFolder, utc_at
from sim_bridge.adapters.lifeline import entry

MAIN = "from sim_bridge.research.benchmarks.fleet_bench.worker import main"
QUIET = {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}
LEASE = {"link": {"tx": {"lease": LEASE_MS}}}
"""As in the network files that `pki` makes."""

STOP_S = 120.0
"""A process that was told to end and has not by then is killed."""


@dataclass(slots=True)
class BenchProcess:
    """A process of ours, spoken to by lines; what it says is read beside us."""

    process: "subprocess.Popen[str]"
    said: "queue.SimpleQueue[str | None]" = field(default_factory=queue.SimpleQueue)

    @classmethod
    def start(cls, *arguments: str) -> "BenchProcess":
        """What `worker.main` does with these arguments."""
        process = subprocess.Popen(
            [sys.executable, "-c", entry(f"{MAIN}; main()"), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )
        worker = cls(process)
        threading.Thread(target=worker._read, daemon=True).start()
        return worker

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said.put(line)
        self.said.put(None)

    def say(self, words: str) -> None:
        """A line to it."""
        assert self.process.stdin is not None
        self.process.stdin.write(words + "\n")
        self.process.stdin.flush()

    def hear(self, limit_s: float) -> str | None:
        """Its next line; None where it has ended, or says nothing for so long."""
        try:
            return self.said.get(timeout=max(0.0, limit_s))
        except queue.Empty:
            return None

    def ends_within(self, limit_s: float) -> bool:
        """Waits so long for its end."""
        try:
            self.process.wait(limit_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def last_words(self) -> str:
        """Its last line, after its standard input has ended."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        words = ""
        while (line := self.hear(STOP_S)) is not None:
            words = line
        return words

    def kill(self) -> None:
        """It ends now; nothing is written any more."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


def cpu_s(worker: BenchProcess) -> float:
    """What it has taken of a processor by now."""
    spent = psutil.Process(worker.process.pid).cpu_times()
    return spent.user + spent.system


def rss_mb(worker: BenchProcess) -> float:
    """The memory that it has."""
    return psutil.Process(worker.process.pid).memory_info().rss / 1e6


def write_config(path: Path, table: dict[str, Any]) -> Path:
    """A zenoh configuration without scouting."""
    transport = LEASE | table.get("transport", {})
    path.write_text(json.dumps(QUIET | table | {"transport": transport}))
    return path


DESK = "desk"
VALID_DAYS = 365


def make_identities(folder: Path, fleet: str, vehicles: list[str], port: int) -> None:
    """A desk that is called on loopback, and its vehicles, as `ground-station pki` makes them."""
    pki = PkiFolder.init(folder, fleet, utc_at(epoch_us()))
    pki.add(DESK, Role.DESK, VALID_DAYS, f"127.0.0.1:{port}")
    pki.add_all(vehicles, Role.VEHICLE, VALID_DAYS)


def member_config(folder: Path, port: int, **more: Any) -> Path:
    """A client that calls again and again, as one with a configuration of `pki` does."""
    retry = {"period_init_ms": 200, "period_max_ms": CALL_AGAIN_MS}
    call = {"endpoints": [f"tcp/127.0.0.1:{port}"], "exit_on_failure": False, "timeout_ms": 0}
    table = {"mode": "client", "connect": call | {"retry": retry}, **more}
    return write_config(folder / f"member-{port}.json5", table)


def desk_config(folder: Path, desk: int, ports: list[int], *, calls: bool) -> Path:
    """It calls every router, or listens for its members."""
    ends = {"endpoints": [f"tcp/127.0.0.1:{port}" for port in ports]}
    many = {"transport": {"unicast": MANY_CALLERS}}
    how = {"connect": ends, "listen": {"endpoints": []}} if calls else {"listen": ends}
    return write_config(folder / f"desk-{desk}.json5", {"mode": "peer", **how, **many})


@dataclass(slots=True)
class BenchRouter:
    """The binding's router, and what may happen to one."""

    folder: Path
    port: int
    process: BenchProcess = field(init=False)

    def __post_init__(self) -> None:
        self._start()

    def _start(self) -> None:
        listens = {"listen": {"endpoints": [f"tcp/127.0.0.1:{self.port}"]}}
        table = {"mode": "router", **listens, "transport": {"unicast": MANY_CALLERS}}
        config = write_config(self.folder / f"router-{self.port}.json5", table)
        self.process = BenchProcess.start("router", str(config))

    def die(self) -> None:
        """As by a power cut; another begins at its address."""
        self.process.kill()
        self._start()

    def freeze(self) -> None:
        """Its members are cut off: lines stand, and nothing comes."""
        self.process.process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """The cut is over."""
        self.process.process.send_signal(signal.SIGCONT)
