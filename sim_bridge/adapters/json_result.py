"""JSON results of commands; an interrupted write leaves the earlier file."""

from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import write_text_atomically


def write_json_result(path: Path, document: object, indent: int = 2) -> None:
    """Replace the file at once: a reader sees either the old document or the new one."""
    text = msgspec.json.format(msgspec.json.encode(document), indent=indent).decode()
    write_text_atomically(path, text + "\n", sync_folder=False)
