"""Run a page's commands one after another, and show how far they are."""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from companion.core.base.errors import LeewayError
from sim_bridge.adapters.wall_clock import wall_s
from sim_bridge.research.reference.programs import PROGRAMS, module_of
from sim_bridge.research.result_pages.machine import Commit
from sim_bridge.research.result_pages.page import DATA, OUT, CommandOutput, Page, PageCommand

FINISHED = "finished"
GRACE_S = 20.0
LINES_OF_AN_ERROR = 12


def folder_of(page: Page, commit: Commit, root: Path) -> tuple[Path, bool]:
    """The folder of a page's own files, and whether a run that was stopped goes on there.

    What another state of the program left is never used.
    """
    folder = root / commit.name / page.name
    if folder.exists() and (commit.is_changed or (folder / FINISHED).exists()):
        shutil.rmtree(folder)
    goes_on = folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    return folder, goes_on


def run_commands(page: Page, out: Path, data: Path | None, console: Console) -> list[CommandOutput]:
    """Every command's output, in order. Whatever stops it ends the command that runs."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    done: list[CommandOutput] = []
    with Progress(*columns, console=console, transient=True) as progress:
        for number, command in enumerate(page.commands, start=1):
            words = f"{page.name}, {number} of {len(page.commands)}: {command.shown(str(out))}"
            task = progress.add_task(f"{words} (all: about {_about(page.minutes)})", total=None)
            done.append(_run(command, out, data))
            progress.remove_task(task)
    (out / FINISHED).touch()
    return done


def _about(minutes: float) -> str:
    return f"{minutes:.0f} min" if minutes >= 1.0 else f"{60.0 * minutes:.0f} s"


def _run(command: PageCommand, out: Path, data: Path | None) -> CommandOutput:
    words = [word.replace(OUT, str(out)).replace(DATA, str(data)) for word in command.argv]
    began_s, before_s = wall_s(), _children_cpu_s()
    with tempfile.TemporaryFile() as printed, tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            call_of(words),
            stdout=printed,
            stderr=said,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        try:
            code = process.wait()
        except BaseException:
            _end(process)
            raise
        printed.seek(0)
        said.seek(0)
        text, errors = printed.read().decode(), said.read().decode()
    if code != 0:
        last = "\n".join((errors or text).strip().splitlines()[-LINES_OF_AN_ERROR:])
        raise LeewayError(f"{' '.join(words)}: exit code {code}\n{last}")
    return CommandOutput(out, data, text, wall_s() - began_s, _children_cpu_s() - before_s)


def call_of(words: Sequence[str]) -> list[str]:
    """How the command is started: one of our programs, by this interpreter; else as it is."""
    if words[0] not in PROGRAMS:
        return list(words)
    start = (
        f"import sys; sys.argv[0] = {words[0]!r}; from {module_of(words[0])} import main; main()"
    )
    return [sys.executable, "-c", start, *words[1:]]


def _end(process: subprocess.Popen[bytes]) -> None:
    """A terminal's Ctrl-C has reached it too; a signal to us alone has not."""
    for end, grace_s in ((None, 2.0), (process.terminate, GRACE_S), (process.kill, GRACE_S)):
        if end is not None:
            end()
        try:
            process.wait(grace_s)
        except subprocess.TimeoutExpired:
            continue
        return


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
