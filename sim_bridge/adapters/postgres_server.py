"""A private PostgreSQL server: installed programs, on loopback, in a temporary folder.

The server ends with the process that started it, however that ends, and its folder is removed.
"""

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import psutil
import psycopg
from psycopg import sql

from companion.core.base.errors import LeewayError
from sim_bridge.adapters.endpoint import find_free_tcp_port
from sim_bridge.adapters.lifeline import end_with_parent

DEBIAN_SERVER_FOLDER = Path("/usr/lib/postgresql")
"""Folders where Debian installs the server programs, which are not on the PATH."""

RUN_AS = ("postgres", "nobody")
"""Accounts to run PostgreSQL as, because it refuses root: the first that exists is used."""

START_S, STOP_S = 60.0, 10.0
"""A start after a SIGKILL reads its log first; a busy machine takes some seconds for it."""

POLL_PERIOD_S = 0.05


@dataclass(frozen=True, slots=True)
class PostgresExecutables:
    """The two programs that a server of one's own takes."""

    initdb: str
    postgres: str

    @classmethod
    def find(cls) -> "PostgresExecutables":
        """Those on the path, or else the newest where Debian keeps them.

        Raises LeewayError where there are none.
        """
        return cls(_find_executable("initdb"), _find_executable("postgres"))


def _find_executable(program: str) -> str:
    kept = sorted(
        DEBIAN_SERVER_FOLDER.glob(f"*/bin/{program}"), key=lambda path: float(path.parts[-3])
    )
    found = shutil.which(program) or (str(kept[-1]) if kept else None)
    if found is None:
        raise LeewayError(
            f"PostgreSQL: no {program} on the path nor in {DEBIAN_SERVER_FOLDER}/*/bin:"
            " expected an installed server (Debian: apt install postgresql)"
        )
    return found


@dataclass(slots=True)
class PostgresServer:
    """One server. `kill` sends SIGKILL; `start_and_wait_until_ready` reuses the same data."""

    executables: PostgresExecutables
    home: Path
    user: str | None
    port: int
    _process: subprocess.Popen[bytes] | None = field(default=None, repr=False)

    @property
    def url(self) -> str:
        """Server URL without a database name."""
        return f"postgresql://desk@127.0.0.1:{self.port}"

    @property
    def pid(self) -> int | None:
        """Process id of the postmaster; None while it does not run."""
        return None if self._process is None else self._process.pid

    def create_database(self, name: str) -> str:
        """Make an empty database; returns its URL."""
        with psycopg.connect(f"{self.url}/postgres", autocommit=True) as admin:
            admin.execute(sql.SQL("CREATE DATABASE {}").format(sql.Identifier(name)))
        return f"{self.url}/{name}"

    def initialise_cluster(self) -> None:
        """Make the empty cluster that it is to serve."""
        data = str(self.home / "data")
        options = ["-U", "desk", "-A", "trust", "--no-sync", "-E", "UTF8"]
        done = subprocess.run(
            [self.executables.initdb, "-D", data, *options],
            user=self.user,
            cwd=self.home,
            capture_output=True,
            text=True,
        )
        if done.returncode != 0:
            raise LeewayError(f"{self.executables.initdb}: {done.stderr.strip()}")

    def start_and_wait_until_ready(self) -> None:
        """Start it, and wait until it takes connections. Raises LeewayError where it does not."""
        with (self.home / "log").open("ab") as log:
            self._process = subprocess.Popen(
                self._server_command_line(),
                user=self.user,
                cwd=self.home,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,  # the terminal's Ctrl-C is for the parent process
                preexec_fn=partial(end_with_parent, os.getpid()),
            )
        for _ in range(round(START_S / POLL_PERIOD_S)):
            if self._accepts_connections():
                return
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(POLL_PERIOD_S)
                break
        raise LeewayError(f"PostgreSQL did not start: {self._log_tail()}")

    def _server_command_line(self) -> list[str]:
        options = {"listen_addresses": "127.0.0.1", "unix_socket_directories": str(self.home)}
        settings = [word for key, value in options.items() for word in ("-c", f"{key}={value}")]
        return [
            self.executables.postgres,
            "-D",
            str(self.home / "data"),
            "-p",
            str(self.port),
            *settings,
        ]

    def _accepts_connections(self) -> bool:
        """Return True if this server accepts connections; another server on the port does not
        count."""
        try:
            with psycopg.connect(f"{self.url}/postgres", connect_timeout=2) as db:
                served = db.execute("SHOW data_directory").fetchone()
        except psycopg.OperationalError:
            return False
        return served == (str(self.home / "data"),)

    def _log_tail(self) -> str:
        lines = (self.home / "log").read_text(errors="replace").strip().splitlines()
        return " | ".join(lines[-3:])

    def kill(self) -> None:
        """SIGKILL of the postmaster and of all that it has started; ends once they are gone."""
        if self._process is None:
            return
        with suppress(psutil.NoSuchProcess):
            children = psutil.Process(self._process.pid).children(recursive=True)
            self._process.kill()
            for child in children:
                with suppress(psutil.NoSuchProcess):
                    child.kill()
            psutil.wait_procs(children, timeout=STOP_S)
        self._process.wait()
        self._process = None

    def stop_immediately(self) -> None:
        """End it at once; its data is thrown away."""
        if self._process is None:
            return
        self._process.send_signal(signal.SIGQUIT)
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.kill()
        self._process = None


@contextmanager
def running_postgres_server() -> Iterator[PostgresServer]:
    """A server that runs, on an empty cluster.

    Raises LeewayError where none is installed, or it does not start.
    """
    executables, user = PostgresExecutables.find(), _unprivileged_user_if_root()
    with tempfile.TemporaryDirectory(prefix="leeway-pg-") as home:
        if user is not None:
            shutil.chown(home, user)
        server = PostgresServer(executables, Path(home), user, find_free_tcp_port())
        server.initialise_cluster()
        try:
            server.start_and_wait_until_ready()
            yield server
        finally:
            server.stop_immediately()


def _unprivileged_user_if_root() -> str | None:
    if os.geteuid() != 0:
        return None
    names = {entry.pw_name for entry in pwd.getpwall()}
    return next((name for name in RUN_AS if name in names), None)
