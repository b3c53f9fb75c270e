"""Cache of the planner's machine code: one folder in the user's cache per state of the sources."""

import hashlib
import os
import shutil
from pathlib import Path

import ground_station.core

MAX_CACHED_STATES = 4
FIRST_COMPILATION_NOTICE = "first run: compiling the planner, about a minute"


def enable_compile_cache_and_check_if_known() -> bool:
    """Cache the planner's compiled code; call it before the planner's first import.

    Returns False if it will compile for the first time, which takes about 40 s of one core.
    """
    import numba  # 80 MB: only planner processes import it, not the desk
    from numba.core import config

    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "leeway"
    folder = root / f"truck_drones-{_compiler_and_sources_digest(numba.__version__)}"
    known = folder.is_dir()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        _delete_oldest_cache_folders(root)
    except OSError:
        return False  # a read-only home: each process compiles again
    config.CACHE_DIR = str(folder)  # pyright: ignore[reportAttributeAccessIssue]
    return known


def _compiler_and_sources_digest(compiler_version: str) -> str:
    digest = hashlib.sha256(compiler_version.encode())
    for package in ground_station.core.__path__:
        for path in sorted(Path(package, "truck_drones").rglob("*.py")):
            digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _delete_oldest_cache_folders(root: Path) -> None:
    states = sorted(root.glob("truck_drones-*"), key=lambda path: path.stat().st_mtime)
    for path in states[:-MAX_CACHED_STATES]:
        shutil.rmtree(path, ignore_errors=True)
