"""Cache of the planner's machine code: one folder in the user's cache per state of the sources."""

import hashlib
import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import ground_station.core

if TYPE_CHECKING:
    from rich.console import Console

MAX_CACHED_STATES = 4


def enable_compile_cache_and_print_notice(console: "Console") -> None:
    """Cache the planner's compiled code, and announce its first compilation."""
    if not enable_compile_cache_and_check_if_known():
        console.print("first run: compiling the planner, about a minute", highlight=False)


def enable_compile_cache_and_check_if_known() -> bool:
    """Cache the planner's compiled code; call it before the planner's first import.

    Returns False if it will compile for the first time, which takes about 40 s of one core.
    """
    import numba  # 80 MB: only planner processes import it, not the desk
    from numba.core import config

    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "leeway"
    digest = digest_of_text_and_files(numba.__version__, planner_sources())[:16]
    folder = root / f"truck_drones-{digest}"
    known = folder.is_dir()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        states = sorted(root.glob("truck_drones-*"), key=lambda path: path.stat().st_mtime)
        for path in states[:-MAX_CACHED_STATES]:
            shutil.rmtree(path, ignore_errors=True)
    except OSError:
        return False  # a read-only home: each process compiles again
    config.CACHE_DIR = str(folder)  # pyright: ignore[reportAttributeAccessIssue]
    return known


def planner_sources() -> list[Path]:
    """Return the planner's source files."""
    packages = ground_station.core.__path__
    return [path for one in packages for path in sorted(Path(one, "truck_drones").rglob("*.py"))]


def digest_of_text_and_files(text: str, paths: Iterable[Path]) -> str:
    """Return a digest of a text and of files with their names."""
    digest = hashlib.sha256(text.encode())
    for path in paths:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
