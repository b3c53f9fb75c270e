"""The checkpoint on disk: written whole or not at all, checked when read."""

from pathlib import Path
from typing import Any

from companion.adapters.files.atomic_file import read_whole, write_whole
from companion.core.base.errors import LeewayError
from companion.core.pilot.checkpoint import Checkpoint, checkpoint_from_dict

NAME = "checkpoint.json"


def write_checkpoint(run_dir: Path, content: dict[str, Any], *, settle: bool = True) -> None:
    """Replace the checkpoint; `settle` as in `write_whole`."""
    write_whole(run_dir / NAME, content, settle=settle)


def read_checkpoint(run_dir: Path, flight: str) -> Checkpoint | None:
    """Read the checkpoint of this flight; `None` where there is none.

    Raises LeewayError where it is torn or belongs to another flight or airframe.
    """
    path = run_dir / NAME
    table = read_whole(path, "checkpoint")
    if table is None:
        return None
    kept = checkpoint_from_dict(table, str(path))
    if kept.flight != flight:
        raise LeewayError(f"{path}: belongs to another flight or airframe")
    return kept
