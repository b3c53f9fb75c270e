"""Processes forked from one that has imported their program already: a start costs no imports.

For suites of many short flights, where imports were half of what a companion costs. What is forked
runs as if it were started anew: its own session, streams, arguments, environment and exit code.
"""

import contextlib
import gc
import json
import math
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from typing import IO, Any

from sim_bridge.adapters.lifeline import entry, hold

LARGEST_MESSAGE = 1 << 17
LOOK_AFTER_S = 10.0


class ForkedProcess:
    """One process of a `ForkServer`, with what we use of `subprocess.Popen`."""

    def __init__(self, pid: int, server: "ForkServer") -> None:
        self.pid = pid
        self._server = server

    def poll(self) -> int | None:
        """Its exit code once it has ended; minus the signal that ended it."""
        return self._server.code_of(self.pid, 0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code at its end; subprocess.TimeoutExpired where that takes longer."""
        until_s = math.inf if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                raise subprocess.TimeoutExpired("fork", timeout or 0.0)
            self._server.code_of(self.pid, min(left_s, LOOK_AFTER_S))
        return code

    def send_signal(self, sig: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):  # it ends just now
                os.kill(self.pid, sig)

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """Runs `main` (Python) in one process after another; `imports` names the modules it needs.

    Itself it starts at the first use. It and all its processes end with the one that uses it.
    """

    def __init__(self, imports: Sequence[str], main: str, environment: Mapping[str, str]) -> None:
        """`environment` is added to ours."""
        self._imports = imports
        self._main = main
        self._added = dict(environment)
        self._line: socket.socket | None = None
        self._server: subprocess.Popen[bytes] | None = None
        self._started: list[int] = []
        self.cpu_s = 0.0
        """Of its processes that have ended."""
        self._codes: dict[int, int] = {}

    def start(self, arguments: Sequence[str], output: IO[bytes]) -> ForkedProcess:
        """Start one; what it prints, errors too, goes to `output`."""
        if self._line is None:
            self._line = self._open()
        asked = {
            "arguments": list(arguments),
            "folder": os.getcwd(),
            "environment": os.environ | self._added,
        }
        socket.send_fds(self._line, [json.dumps(asked).encode()], [output.fileno()])
        while not self._started:
            self._hear(None)
        return ForkedProcess(self._started.pop(), self)

    def code_of(self, pid: int, limit_s: float) -> int | None:
        """The exit code of one of its processes, waiting so long at most for anything new."""
        if pid not in self._codes:
            self._hear(limit_s)
        return self._codes.get(pid)

    def close(self) -> None:
        """End it, and what it still runs."""
        if self._line is not None and self._server is not None:
            self._line.close()
            self._server.wait()
            self._line = None

    def _open(self) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        before = "".join(f"import {name}; " for name in self._imports)
        serving = f"from sim_bridge.adapters.fork_server import serve; serve({theirs.fileno()})"
        self._server = subprocess.Popen(
            [sys.executable, "-c", entry(f"{before}{serving}\n{self._main}")],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env=os.environ | self._added,
            pass_fds=[theirs.fileno()],
            start_new_session=True,
        )
        theirs.close()
        return ours

    def _hear(self, limit_s: float | None) -> None:
        """Take what the server says, waiting so long for it at most."""
        assert self._line is not None
        while select.select([self._line], [], [], limit_s)[0]:
            said = self._line.recv(LARGEST_MESSAGE)
            if not said:
                raise ChildProcessError("the fork server ended before those who use it")
            pid, code, used_s = json.loads(said)
            if code is None:
                self._started.append(pid)
                self._codes.pop(pid, None)  # of an earlier process with that number
            else:
                self._codes[pid] = code
                self.cpu_s += used_s
            limit_s = 0.0


def serve(descriptor: int) -> None:
    """Fork whenever asked; returns in each fork, and never in the server."""
    server = os.getpid()
    line = socket.socket(fileno=descriptor)
    ended, tells = os.pipe()
    os.set_blocking(tells, False)
    gc.freeze()  # no fork walks through what was imported
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(tells, warn_on_full_buffer=False)
    while True:
        ready, _, _ = select.select([line, ended], [], [])
        if ended in ready:
            os.read(ended, LARGEST_MESSAGE)
            _tell_ended(line)
        if line not in ready:
            continue
        words, files, _, _ = socket.recv_fds(line, LARGEST_MESSAGE, 1)
        if not words:
            os._exit(0)
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            for each in (ended, tells):
                os.close(each)
            line.close()
            _become(json.loads(words), files[0], server)
            return
        os.close(files[0])
        line.send(json.dumps([pid, None, 0.0]).encode())


def _tell_ended(line: socket.socket) -> None:
    while True:
        try:
            pid, status, used = os.wait4(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        code, used_s = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        line.send(json.dumps([pid, code, used_s]).encode())


def _become(asked: dict[str, Any], output: int, server: int) -> None:
    os.setsid()
    hold(server)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.close(output)
    os.chdir(asked["folder"])
    os.environ.clear()
    os.environ.update(asked["environment"])
    sys.argv[1:] = asked["arguments"]
