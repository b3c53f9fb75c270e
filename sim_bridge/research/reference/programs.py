"""The three programs as the command line runs them: what each console script hands to click."""

import importlib
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import typer
from typer.main import get_command

PROGRAMS = {
    "companion": "companion.app.cli.main",
    "ground-station": "ground_station.app.cli.main",
    "sim-bridge": "sim_bridge.app.cli.main",
}
"""Console scripts of pyproject.toml, and the module of their `main`."""


def root_command(program: str) -> Any:
    """The program's click command, with everything that its `main` adds before it runs it."""
    seen: list[typer.Typer] = []
    with _put_back_signals(), patch.object(sys, "argv", [program]):
        main = importlib.import_module(PROGRAMS[program]).main
        with patch.object(typer.Typer, "__call__", lambda app, *_, **__: seen.append(app)):
            main()
    return get_command(seen[0])


@contextmanager
def _put_back_signals() -> Iterator[None]:
    """A program may set how it stops; who only reads its commands keeps their own way."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
