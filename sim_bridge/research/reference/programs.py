"""The click commands of the three console scripts, as the command line runs them."""

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

CONSOLE_SCRIPTS = ("companion", "ground-station", "sim-bridge")
"""Console scripts of the distribution."""

ROOT = Path(__file__).resolve().parents[3]


def main_module_of_program(program: str) -> str:
    """Return the module of a console script's `main`, from the checkout or the installation."""
    project = ROOT / "pyproject.toml"
    if project.is_file():
        scripts = tomllib.loads(project.read_text(encoding="utf-8"))["project"]["scripts"]
        return scripts[program].partition(":")[0]
    (script,) = entry_points(group="console_scripts", name=program)
    return script.module


def load_root_command(program: str) -> Any:
    """Return the program's click command, including everything that its `main` adds to it."""
    seen: list[typer.Typer] = []
    with _preserved_signals(), patch.object(sys, "argv", [program]):
        main = importlib.import_module(main_module_of_program(program)).main
        with patch.object(typer.Typer, "__call__", lambda app, *_, **__: seen.append(app)):
            main()
    return get_command(seen[0])


@contextmanager
def _preserved_signals() -> Iterator[None]:
    """Restore the signal handlers, which a program's `main` may replace."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
