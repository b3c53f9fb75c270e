"""Exceptions in the files of a run: tracebacks in output and logs, and an exception of the run."""

import traceback
from pathlib import Path

TRACEBACK = "Traceback (most recent call last)"
OUTPUT_SUFFIXES = {".log", ".txt", ".out"}


def count_tracebacks_by_file(folder: Path) -> dict[str, int]:
    """Return the number of tracebacks in each output or log file that contains any."""
    paths = sorted(path for path in folder.rglob("*") if path.suffix in OUTPUT_SUFFIXES)
    counts = {
        str(path.relative_to(folder)): path.read_text(errors="replace").count(TRACEBACK)
        for path in paths
    }
    return {name: count for name, count in counts.items() if count}


def write_exception_file(folder: Path, error: Exception) -> str:
    """Write the traceback of a run that raised this exception, and return its description."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "exception.txt").write_text("".join(traceback.format_exception(error)))
    return f"an exception: {type(error).__name__}: {error}"
