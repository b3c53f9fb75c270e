"""What signing keeps on the disk: the key, and the newest time stamp of every stream heard."""

import os
import re
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from companion.adapters.files.atomic_file import read_whole, write_whole
from companion.core.base.errors import LeewayError

KEY_BYTES = 32
CREDENTIALS = "${CREDENTIALS_DIRECTORY}"
"""In a key's path: systemd's folder of credentials, which only the service can read."""

STAMPS = "signing.json"
SAVE_S = 1.0
"""Time stamps are on the disk so soon: what was signed in that second before a power cut is all
that may be heard twice, and a restart takes longer.
"""

TICKS_A_SECOND = 100_000
Streams = dict[tuple[int, int, int], int]


def read_signing_key(path: Path) -> bytes:
    """Read a 32-byte key: raw bytes, or 64 hexadecimal digits.

    Raises LeewayError where others than its owner may read it: then it is no secret.
    """
    path = credential(path)
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


def credential(path: Path) -> Path:
    """The path, with systemd's folder of credentials in the place of its name."""
    text = str(path)
    if not text.startswith(CREDENTIALS):
        return path
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    if folder is None:
        raise LeewayError(f"{text}: this is no service of systemd with LoadCredential=")
    return Path(text.replace(CREDENTIALS, folder, 1))


def write_signing_key(path: Path, key: bytes) -> None:
    """A new key file that only its owner can read; LeewayError where there is one already."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    with os.fdopen(descriptor, "wb") as file:
        file.write(key)
        file.flush()
        os.fsync(file.fileno())


class _Heard(Protocol):
    @property
    def streams(self) -> Streams: ...
    def remember(self, streams: Streams) -> None: ...


class StampKeeper:
    """Keeps the time stamps of one vehicle's key through restarts.

    Without it a frame of the last minute, heard before a restart, would be heard again after it.
    """

    def __init__(self, folder: Path, codec: _Heard) -> None:
        """Take up what an earlier process heard; a broken file is moved aside (`trouble`)."""
        self._path = folder / STAMPS
        self._codec = codec
        self._saved_s: float | None = None
        folder.mkdir(parents=True, exist_ok=True)
        self.trouble = ""
        try:
            kept = _streams_of(read_whole(self._path, "record of time stamps"), self._path)
        except LeewayError as error:
            self.trouble, kept = f"moved aside: {error}", {}
            self._path.replace(self._path.with_suffix(".broken"))
        codec.remember(kept)

    def due(self, t_s: float) -> Callable[[], None] | None:
        """What is to be written now, by whoever may wait for the disk; `None`: nothing yet."""
        if self._saved_s is not None and t_s - self._saved_s < SAVE_S:
            return None
        self._saved_s = t_s
        table = {f"{a}/{b}/{c}": stamp for (a, b, c), stamp in self._codec.streams.items()}
        return lambda: write_whole(self._path, table, settle=False)


def _streams_of(table: object, path: Path) -> Streams:
    """Link, system and component of each stream, and its newest time stamp."""
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
