"""The three programs as the command line runs them: what each console script hands to click."""

import importlib
import signal
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest.mock import patch

import typer
from typer.main import get_command

PROGRAMS = ("companion", "ground-station", "sim-bridge")
"""Console scripts of the distribution."""

ROOT = Path(__file__).resolve().parents[3]


def module_of(program: str) -> str:
    """The module of a console script's `main`: as the checkout has it, else as it is installed."""
    project = ROOT / "pyproject.toml"
    if project.is_file():
        scripts = tomllib.loads(project.read_text(encoding="utf-8"))["project"]["scripts"]
        return scripts[program].partition(":")[0]
    (script,) = entry_points(group="console_scripts", name=program)
    return script.module


def root_command(program: str) -> Any:
    """The program's click command, with everything that its `main` adds before it runs it."""
    seen: list[typer.Typer] = []
    with _put_back_signals(), patch.object(sys, "argv", [program]):
        main = importlib.import_module(module_of(program)).main
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
