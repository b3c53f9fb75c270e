"""JSON files that are written whole or not at all, and read with suspicion."""

import json
import os
import zlib
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError


def write_whole(path: Path, content: Any, *, settle: bool = True) -> None:
    """Replace a file: a torn write leaves the one before.

    `settle` also waits until the folder is on the disk, so that even a power cut right afterwards
    finds the new one; without it that may find the one before.
    """
    write_text_whole(path, sealed(content), settle=settle)


def sealed(content: Any) -> str:
    """The content as text with its checksum."""
    body = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return json.dumps({"crc32": zlib.crc32(body.encode()), "content": body})


def write_text_whole(path: Path, text: str, *, settle: bool = True) -> None:
    """Replace a file by a text; `settle` as in `write_whole`."""
    fresh = path.with_name(f"{path.name}.new")
    with fresh.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(path)
    if settle:
        settle_folder(path.parent)


def settle_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_whole(path: Path, what: str) -> Any | None:
    """What was written, `None` where there is no such file; LeewayError where it is torn."""
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
        content = json.loads(body)
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise LeewayError(f"{path}: not a whole {what}") from error
    if not whole:
        raise LeewayError(f"{path}: not a whole {what} (checksum)")
    return content
