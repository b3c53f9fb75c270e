"""A file with the store's URL: where a password may stand, because only its owner reads it."""

import stat
from pathlib import Path
from urllib.parse import urlsplit

from companion.core.base.errors import LeewayError


def read_store_file(path: Path) -> str:
    """The URL in a file. Raises LeewayError where others may read it, or it holds no one line."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        lines = path.read_text(encoding="utf-8").split()
    except (OSError, UnicodeDecodeError) as error:
        raise LeewayError(f"--store-file {path}: {error}") from error
    if mode & 0o077:
        raise LeewayError(f"--store-file {path}: mode {mode:04o}, expected 0600: chmod 600 {path}")
    if len(lines) != 1:
        raise LeewayError(f"--store-file {path}: {len(lines)} words, expected one URL")
    return lines[0]


def refuse_password(url: str) -> None:
    """Raise LeewayError where a URL of the command line holds a password."""
    try:
        password = urlsplit(url).password
    except ValueError:
        return  # no URL: the store says so
    if password is not None:
        raise LeewayError(
            "--store: with a password in it everybody on this machine reads it (ps): put it into"
            " ~/.pgpass, or the URL into a file of mode 0600 for --store-file"
        )
