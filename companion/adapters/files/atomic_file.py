"""JSON files that are replaced atomically and verified by a checksum when read."""

import json
import os
import zlib
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError


def write_json_atomically(path: Path, content: Any, *, sync_folder: bool = True) -> None:
    """Replace a file; an interrupted write leaves the previous file.

    `sync_folder` also waits until the folder is on the disk, so that the new file survives a power
    cut; without it a power cut may restore the previous file.
    """
    write_text_atomically(path, json_text_with_checksum(content), sync_folder=sync_folder)


def json_text_with_checksum(content: Any) -> str:
    """Return the content as text with its checksum."""
    body = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return json.dumps({"crc32": zlib.crc32(body.encode()), "content": body})


def write_text_atomically(path: Path, text: str, *, sync_folder: bool = True) -> None:
    """Replace a file by a text; `sync_folder` as in `write_json_atomically`."""
    temporary_file = path.with_name(f"{path.name}.new")
    with temporary_file.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    temporary_file.replace(path)
    if sync_folder:
        fsync_folder(path.parent)


def fsync_folder(folder: Path) -> None:
    """Wait until a folder's directory entries are on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_checked_json(path: Path, content_name: str) -> Any | None:
    """Return the content, `None` without a file; raise LeewayError if it is incomplete."""
    try:
        text = path.read_text()
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise LeewayError(f"{path}: {error}") from error
    try:
        outer = json.loads(text)
        body = outer["content"]
        is_intact = zlib.crc32(body.encode()) == outer["crc32"]
        content = json.loads(body)
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise LeewayError(f"{path}: incomplete or damaged {content_name}") from error
    if not is_intact:
        raise LeewayError(f"{path}: incomplete or damaged {content_name} (checksum)")
    return content
