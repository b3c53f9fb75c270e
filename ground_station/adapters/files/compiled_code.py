"""The cache of the planner's machine code: one folder of the user's for each state of the
sources.
"""

import hashlib
import os
import shutil
from pathlib import Path

import ground_station.core

KEPT_STATES = 4


def keep_compiled_code() -> bool:
    """Cache what the planner compiles; call it before the planner's first import.

    False: it compiles for the first time, which takes some ten seconds of one core.
    """
    import numba  # 80 MB: a desk names its planner, and has it plan in a process of its own
    from numba.core import config

    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "leeway"
    folder = root / f"truck_drones-{_digest(numba.__version__)}"
    known = folder.is_dir()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        _forget_old(root)
    except OSError:
        return False  # a read-only home: each process compiles again
    config.CACHE_DIR = str(folder)  # pyright: ignore[reportAttributeAccessIssue]
    return known


def _digest(compiler: str) -> str:
    digest = hashlib.sha256(compiler.encode())
    for package in ground_station.core.__path__:
        for path in sorted(Path(package, "truck_drones").rglob("*.py")):
            digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _forget_old(root: Path) -> None:
    states = sorted(root.glob("truck_drones-*"), key=lambda path: path.stat().st_mtime)
    for path in states[:-KEPT_STATES]:
        shutil.rmtree(path, ignore_errors=True)
