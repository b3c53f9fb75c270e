"""A private PostgreSQL server: a SIGKILL loses no data, and it ends with its parent process."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import psycopg
import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.adapters import postgres_server as module
from sim_bridge.adapters.postgres_server import (
    PostgresExecutables,
    PostgresServer,
    running_postgres_server,
)

PATIENCE_S = 20.0


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    try:
        PostgresExecutables.find()
    except LeewayError as error:
        pytest.skip(str(error))
    with running_postgres_server() as started:
        yield started


@pytest.mark.sample
def test_what_was_committed_is_there_after_a_sigkill_and_a_new_start(server):
    url = server.create_database("kept")
    with psycopg.connect(url, autocommit=True) as db:
        db.execute("CREATE TABLE seen AS SELECT 7 AS n")
        backend = db.info.backend_pid
    server.kill()
    assert not psutil.pid_exists(backend) or psutil.Process(backend).status() == "zombie"
    with pytest.raises(psycopg.OperationalError):
        psycopg.connect(url, connect_timeout=2)
    server.start_and_wait_until_ready()
    with psycopg.connect(url) as db:
        assert db.execute("SELECT n FROM seen").fetchall() == [(7,)]


def test_a_server_that_cannot_start_says_what_its_log_says(server, tmp_path):
    tmp_path.chmod(0o777)
    twice = PostgresServer(server.executables, tmp_path, server.user, server.port)
    with pytest.raises(LeewayError, match=r"did not start: .*data"):
        twice.start_and_wait_until_ready()


def test_where_no_server_is_installed_the_error_says_what_was_looked_for_and_where(
    monkeypatch, tmp_path
):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(module, "DEBIAN_SERVER_FOLDER", tmp_path)
    with pytest.raises(LeewayError, match=f"no initdb on the path nor in {tmp_path}"):
        PostgresExecutables.find()


@pytest.mark.sample
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="prctl(2) is Linux's")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_the_server_is_gone_when_its_parent_is_stopped_or_killed(server, number):
    code = (
        "from sim_bridge.adapters.postgres_server import running_postgres_server\n"
        "with running_postgres_server() as server:\n"
        "    print(server.pid, server.home, flush=True)\n"
        "    input()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=Path(__file__).parents[3],
        text=True,
    ) as parent:
        assert parent.stdout is not None
        pid, home = parent.stdout.readline().split()
        postmaster = psutil.Process(int(pid))
        os.kill(parent.pid, number)
        parent.wait(PATIENCE_S)
        assert _gone(postmaster)
        assert number is signal.SIGKILL or not Path(home).exists()
        shutil.rmtree(home, ignore_errors=True)  # a killed process removes nothing


def _gone(process: psutil.Process) -> bool:
    try:
        process.wait(PATIENCE_S)
    except psutil.TimeoutExpired:
        return process.status() == psutil.STATUS_ZOMBIE
    return True
