"""The checkpoint on disk: written whole or not at all, and read with suspicion."""

import json
import os
import zlib
from pathlib import Path
from typing import Any

from companion.core.errors import LeewayError
from companion.core.kept import Kept, kept_from_dict

NAME = "checkpoint.json"


def write_checkpoint(run_dir: Path, content: dict[str, Any], *, settle: bool = True) -> None:
    """Replace the checkpoint: a torn write leaves the one before.

    `settle` also waits until the folder is on the disk, so that even a power cut right afterwards
    finds the new one; without it that may find the one before.
    """
    body = json.dumps(content, allow_nan=False, separators=(",", ":"))
    text = json.dumps({"crc32": zlib.crc32(body.encode()), "content": body})
    fresh = run_dir / f"{NAME}.new"
    with fresh.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(run_dir / NAME)
    if not settle:
        return
    folder = os.open(run_dir, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def read_checkpoint(run_dir: Path, flight: str) -> Kept | None:
    """Read the checkpoint of this flight; `None` where there is none.

    Raises LeewayError where it is torn or belongs to another flight or airframe.
    """
    path = run_dir / NAME
    try:
        text = path.read_text()
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise LeewayError(f"{path}: {error}") from error
    try:
        outer = json.loads(text)
        body = outer["content"]
        whole = zlib.crc32(body.encode()) == outer["crc32"]
        table = json.loads(body)
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise LeewayError(f"{path}: not a whole checkpoint") from error
    if not whole:
        raise LeewayError(f"{path}: not a whole checkpoint (checksum)")
    kept = kept_from_dict(table, str(path))
    if kept.flight != flight:
        raise LeewayError(f"{path}: belongs to another flight or airframe")
    return kept
