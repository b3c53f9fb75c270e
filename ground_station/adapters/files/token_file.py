"""The file of the map's access tokens: readable only by its owner, written atomically."""

import secrets
import stat
from pathlib import Path

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.atomic_file import write_file_atomically
from ground_station.core.people.web_tokens import TOKEN_BYTES, TokenRegistry

PRIVATE_MODE = 0o600


def generate_random_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def read_owner_only_tokens(path: Path) -> TokenRegistry:
    """Read the tokens. Raises LeewayError if others can read the file or it is invalid."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        raw = path.read_bytes()
    except FileNotFoundError as error:
        remedy = f"`ground-station token add NAME --tokens {path}` creates it"
        raise LeewayError(f"--tokens {path}: no such file: {remedy}") from error
    except OSError as error:
        raise LeewayError(f"--tokens {path}: {error.strerror}") from error
    if mode & 0o077:
        raise LeewayError(f"--tokens {path}: mode {mode:04o}, expected 0600: chmod 600 {path}")
    try:
        tokens = msgspec.json.decode(raw, type=TokenRegistry)
        for holder in tokens.holders:
            _ = holder.operator
    except (msgspec.DecodeError, LeewayError) as error:
        raise LeewayError(f"--tokens {path}: {error}: expected map-tokens/1") from error
    return tokens


def write_owner_only_tokens_atomically(path: Path, tokens: TokenRegistry) -> None:
    """Write the tokens atomically. Raises LeewayError."""
    content = msgspec.json.format(msgspec.json.encode(tokens)) + b"\n"
    write_file_atomically(path, content, PRIVATE_MODE)


class TokenFileMonitor:
    """Current tokens of a file that is reread on change: a revocation takes effect at once.

    A file that is unreadable or invalid grants access to no one.
    """

    def __init__(self, path: Path) -> None:
        """Raises LeewayError if the file is invalid at the start."""
        self._path, self._tokens = path, read_owner_only_tokens(path)
        self._last_stamp = _file_stamp(path)

    def current_tokens(self) -> TokenRegistry:
        """Return the current tokens with their holders."""
        mark = _file_stamp(self._path)
        if mark != self._last_stamp:
            self._last_stamp, self._tokens = mark, self._read_tokens_or_empty()
        return self._tokens

    def _read_tokens_or_empty(self) -> TokenRegistry:
        try:
            return read_owner_only_tokens(self._path)
        except LeewayError:
            return TokenRegistry()


def _file_stamp(path: Path) -> tuple[int, ...]:
    try:
        seen = path.stat()
    except OSError:
        return ()
    return seen.st_ino, seen.st_mtime_ns, seen.st_size, seen.st_mode
