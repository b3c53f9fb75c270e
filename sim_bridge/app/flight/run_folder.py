"""A run's own folder, new for each run."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from companion.core.base.errors import LeewayError


def new_run_dir(root: Path, stem: str) -> Path:
    """Make `root/stem`, or `root/stem-N` where that exists."""
    for attempt in range(1, 10_000):
        run_dir = root / (stem if attempt == 1 else f"{stem}-{attempt}")
        with contextlib.suppress(FileExistsError):
            run_dir.mkdir(parents=True)
            return run_dir
    raise LeewayError(f"{root}: no free name like {stem}-N")


@contextlib.contextmanager
def saved_on_interrupt(run_dir: Path) -> Iterator[None]:
    """Leave a word in the folder when a signal ends the run."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        (run_dir / "INTERRUPTED").write_text("stopped by a signal before the flight's end\n")
        raise
