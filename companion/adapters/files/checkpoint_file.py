"""The checkpoint on disk: replaced atomically, verified when read."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from companion.adapters.files.atomic_file import (
    json_text_with_checksum,
    read_checked_json,
    write_text_atomically,
)
from companion.core.base.errors import LeewayError
from companion.core.mission.checkpoint import Checkpoint, checkpoint_from_dict

CHECKPOINT_NAME = "checkpoint.json"


def checkpoint_write_job(
    run_dir: Path, content: dict[str, Any], *, sync_folder: bool = True
) -> Callable[[], None]:
    """Encode now; return the job that replaces the file, `sync_folder` as in `atomic_file`."""
    path, text = run_dir / CHECKPOINT_NAME, json_text_with_checksum(content)
    return lambda: write_text_atomically(path, text, sync_folder=sync_folder)


def read_checkpoint(run_dir: Path, flight_digest: str) -> Checkpoint | None:
    """Read the checkpoint of this flight; `None` without one.

    Raises LeewayError if it is incomplete or belongs to another flight or airframe.
    """
    path = run_dir / CHECKPOINT_NAME
    table = read_checked_json(path, "checkpoint")
    if table is None:
        return None
    checkpoint = checkpoint_from_dict(table, str(path))
    if checkpoint.flight != flight_digest:
        raise LeewayError(f"{path}: belongs to another flight or airframe")
    return checkpoint
