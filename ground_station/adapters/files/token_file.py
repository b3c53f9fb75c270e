"""The file of the map's tokens: only its owner reads it, and it is whole or not written at all."""

import os
import secrets
import stat
from pathlib import Path

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.core.people.web_tokens import TOKEN_BYTES, TokenBook

PRIVATE = 0o600


def new_token() -> str:
    """A token that nobody guesses."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def read_tokens(path: Path) -> TokenBook:
    """The tokens in a file. LeewayError where others may read it, or it is none."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        raw = path.read_bytes()
    except FileNotFoundError as error:
        remedy = f"`ground-station token add NAME --tokens {path}` makes it"
        raise LeewayError(f"--tokens {path}: is not there: {remedy}") from error
    except OSError as error:
        raise LeewayError(f"--tokens {path}: {error.strerror}") from error
    if mode & 0o077:
        raise LeewayError(f"--tokens {path}: mode {mode:04o}, expected 0600: chmod 600 {path}")
    try:
        book = msgspec.json.decode(raw, type=TokenBook)
        for holder in book.people:
            _ = holder.person
    except (msgspec.DecodeError, LeewayError) as error:
        raise LeewayError(f"--tokens {path}: {error}: expected map-tokens/1") from error
    return book


def write_tokens(path: Path, book: TokenBook) -> None:
    """Write them. Raises LeewayError."""
    fresh = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        number = os.open(fresh, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE)
        with os.fdopen(number, "wb") as file:
            file.write(msgspec.json.format(msgspec.json.encode(book)) + b"\n")
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        raise LeewayError(f"--tokens {path}: {error.strerror}") from error


class WatchedTokens:
    """The tokens as the file has them now: who is revoked is out at once.

    A file that cannot be read, or is not valid, lets nobody in.
    """

    def __init__(self, path: Path) -> None:
        """Raises LeewayError where the file is not valid from the beginning."""
        self._path, self._book = path, read_tokens(path)
        self._seen = _mark(path)

    def book(self) -> TokenBook:
        """Who has a token."""
        mark = _mark(self._path)
        if mark != self._seen:
            self._seen, self._book = mark, self._read()
        return self._book

    def _read(self) -> TokenBook:
        try:
            return read_tokens(self._path)
        except LeewayError:
            return TokenBook()


def _mark(path: Path) -> tuple[int, ...]:
    try:
        seen = path.stat()
    except OSError:
        return ()
    return seen.st_ino, seen.st_mtime_ns, seen.st_size, seen.st_mode
