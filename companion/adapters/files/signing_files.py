"""Signing data on disk: the key, and the newest time stamp of every stream received."""

import os
import re
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from companion.adapters.files.atomic_file import read_checked_json, write_json_atomically
from companion.core.base.errors import LeewayError

KEY_BYTES = 32
CREDENTIALS = "${CREDENTIALS_DIRECTORY}"
"""In a key's path: systemd's credentials folder, which only the service can read."""

STAMPS_NAME = "signing.json"
SAVE_INTERVAL_S = 1.0
"""Save interval of the time stamps: after a power cut, only frames signed in the last second could
be accepted twice, and a restart takes longer.
"""

Streams = dict[tuple[int, int, int], int]


def read_signing_key(path: Path) -> bytes:
    """Read a 32-byte key: raw bytes, or 64 hexadecimal digits.

    Raises LeewayError if group or others may read the file.
    """
    path = resolve_credentials_path(path)
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        raw = path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise LeewayError(f"{path}: mode {mode:04o}: group or others may read it; chmod 600")
    if len(raw) == KEY_BYTES:
        return raw
    try:
        key = bytes.fromhex(raw.decode("ascii").strip())
    except ValueError as error:
        raise LeewayError(f"{path}: expected 32 bytes, or 64 hexadecimal digits") from error
    if len(key) != KEY_BYTES:
        raise LeewayError(f"{path}: {len(key)} bytes of key, expected {KEY_BYTES}")
    return key


def resolve_credentials_path(path: Path) -> Path:
    """Return the path with the variable of systemd's credentials folder replaced."""
    text = str(path)
    if not text.startswith(CREDENTIALS):
        return path
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    if folder is None:
        raise LeewayError(f"{text}: not a systemd service with LoadCredential=")
    return Path(text.replace(CREDENTIALS, folder, 1))


def write_signing_key(path: Path, key: bytes) -> None:
    """Write a new key file that only its owner can read; LeewayError if the file exists."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    with os.fdopen(descriptor, "wb") as file:
        file.write(key)
        file.flush()
        os.fsync(file.fileno())


class _StampedCodec(Protocol):
    @property
    def newest_signing_timestamp_by_stream(self) -> Streams: ...
    def restore_signing_timestamps(self, newest_timestamp_by_stream: Streams) -> None: ...
    def refuse_streams_signed_before_start(self) -> None: ...


class SigningStampStore:
    """Preserves the time stamps of one vehicle's key through restarts.

    Without it, a frame of the last minute before a restart would be accepted again after it.
    """

    def __init__(self, folder: Path, codec: _StampedCodec) -> None:
        """Restore an earlier process's stamps; an unreadable file is renamed (`error_text`).

        Without a file, frames signed before this start are refused.
        """
        self._path = folder / STAMPS_NAME
        self._codec = codec
        self._saved_s: float | None = None
        folder.mkdir(parents=True, exist_ok=True)
        self.error_text = ""
        try:
            restored = _parse_newest_timestamp_by_stream(
                read_checked_json(self._path, "record of time stamps"), self._path
            )
        except LeewayError as error:
            self.error_text, restored = f"renamed to .broken: {error}", {}
            self.error_text += ": frames signed before this start are refused"
            self._path.replace(self._path.with_suffix(".broken"))
        if not restored:
            codec.refuse_streams_signed_before_start()
        codec.restore_signing_timestamps(restored)

    def take_due_write(self, t_s: float) -> Callable[[], None] | None:
        """Return the write that is due now, for the disk thread; `None` if nothing is due."""
        if self._saved_s is not None and t_s - self._saved_s < SAVE_INTERVAL_S:
            return None
        self._saved_s = t_s
        table = {
            f"{a}/{b}/{c}": stamp
            for (a, b, c), stamp in self._codec.newest_signing_timestamp_by_stream.items()
        }
        return lambda: write_json_atomically(self._path, table)


def _parse_newest_timestamp_by_stream(table: object, path: Path) -> Streams:
    """Parse the newest time stamp of each stream (link, system, component)."""
    if table is None:
        return {}
    if not isinstance(table, dict):
        raise LeewayError(f"{path}: expected a table of time stamps")
    found: Streams = {}
    for name, stamp in table.items():
        numbers = re.fullmatch(r"(\d{1,3})/(\d{1,3})/(\d{1,3})", str(name))
        if numbers is None or not isinstance(stamp, int) or not 0 <= stamp < 2**48:
            raise LeewayError(f"{path}: {name!r}: expected LINK/SYSTEM/COMPONENT and a time stamp")
        link, system, component = (int(number) for number in numbers.groups())
        found[link, system, component] = stamp
    return found
