"""Processes forked from a server that has already imported the program, for a fast start.

For suites of many short flights, where imports take half of a companion's run time. A forked
process has its own session, streams, arguments, environment and exit code, as after exec.
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

from sim_bridge.adapters.lifeline import code_tied_to_parent_process, end_with_parent

MAX_MESSAGE_BYTES = 1 << 17
POLL_PERIOD_S = 10.0


class ForkedProcess:
    """One process of a `ForkServer`, with the part of the `subprocess.Popen` interface in use."""

    def __init__(self, pid: int, server: "ForkServer") -> None:
        self.pid = pid
        self._server = server

    def poll(self) -> int | None:
        """Return the exit code (minus the signal number if killed), or None while it runs."""
        return self._server.wait_for_exit_code(self.pid, 0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit code at exit; raises subprocess.TimeoutExpired after the timeout."""
        until_s = math.inf if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                raise subprocess.TimeoutExpired("fork", timeout or 0.0)
            self._server.wait_for_exit_code(self.pid, min(left_s, POLL_PERIOD_S))
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
    """Run `main` (Python code) in forked processes; `imports` names the modules to preload.

    The server starts at the first use. It ends with the calling process, and so do its processes.
    """

    def __init__(self, imports: Sequence[str], main: str, environment: Mapping[str, str]) -> None:
        """Start no process yet; `environment` is added to this process's environment."""
        self._imports = imports
        self._main = main
        self._added = dict(environment)
        self._line: socket.socket | None = None
        self._server: subprocess.Popen[bytes] | None = None
        self._started: list[int] = []
        self.cpu_s = 0.0
        """Exit codes of processes that have ended."""
        self._codes: dict[int, int] = {}

    def start(self, arguments: Sequence[str], output: IO[bytes]) -> ForkedProcess:
        """Start a process; its standard output and error go to `output`."""
        if self._line is None:
            self._line = self._start_server()
        request = {
            "arguments": list(arguments),
            "folder": os.getcwd(),
            "environment": os.environ | self._added,
        }
        socket.send_fds(self._line, [json.dumps(request).encode()], [output.fileno()])
        while not self._started:
            self._receive_messages(None)
        return ForkedProcess(self._started.pop(), self)

    def wait_for_exit_code(self, pid: int, timeout_s: float) -> int | None:
        """Return the exit code of a process, waiting at most the given time for messages."""
        if pid not in self._codes:
            self._receive_messages(timeout_s)
        return self._codes.get(pid)

    def close(self) -> None:
        """End the server and its running processes."""
        if self._line is not None and self._server is not None:
            self._line.close()
            self._server.wait()
            self._line = None

    def _start_server(self) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        before = "".join(f"import {name}; " for name in self._imports)
        serve_code = f"from sim_bridge.adapters.fork_server import serve; serve({theirs.fileno()})"
        self._server = subprocess.Popen(
            [
                sys.executable,
                "-c",
                code_tied_to_parent_process(f"{before}{serve_code}\n{self._main}"),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env=os.environ | self._added,
            pass_fds=[theirs.fileno()],
            start_new_session=True,
        )
        theirs.close()
        return ours

    def _receive_messages(self, timeout_s: float | None) -> None:
        """Read the server's messages, waiting at most the given time."""
        assert self._line is not None
        while select.select([self._line], [], [], timeout_s)[0]:
            message = self._line.recv(MAX_MESSAGE_BYTES)
            if not message:
                raise ChildProcessError("the fork server ended before those who use it")
            pid, code, used_s = json.loads(message)
            if code is None:
                self._started.append(pid)
                self._codes.pop(pid, None)  # of an earlier process with that number
            else:
                self._codes[pid] = code
                self.cpu_s += used_s
            timeout_s = 0.0


def serve(descriptor: int) -> None:
    """Fork at each request. Returns in each fork, never in the server."""
    server = os.getpid()
    line = socket.socket(fileno=descriptor)
    ended, exit_signal_fd = os.pipe()
    os.set_blocking(exit_signal_fd, False)
    gc.freeze()  # forks do not traverse imported objects
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(exit_signal_fd, warn_on_full_buffer=False)
    while True:
        ready, _, _ = select.select([line, ended], [], [])
        if ended in ready:
            os.read(ended, MAX_MESSAGE_BYTES)
            _send_exit_codes_of_ended_children(line)
        if line not in ready:
            continue
        words, files, _, _ = socket.recv_fds(line, MAX_MESSAGE_BYTES, 1)
        if not words:
            os._exit(0)
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            for each in (ended, exit_signal_fd):
                os.close(each)
            line.close()
            _prepare_forked_process(json.loads(words), files[0], server)
            return
        os.close(files[0])
        line.send(json.dumps([pid, None, 0.0]).encode())


def _send_exit_codes_of_ended_children(client_socket: socket.socket) -> None:
    while True:
        try:
            pid, status, used = os.wait4(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        code, used_s = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        client_socket.send(json.dumps([pid, code, used_s]).encode())


def _prepare_forked_process(request: dict[str, Any], output_fd: int, server_pid: int) -> None:
    os.setsid()
    end_with_parent(server_pid)
    for stream in (1, 2):
        os.dup2(output_fd, stream)
    os.close(output_fd)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv[1:] = request["arguments"]
