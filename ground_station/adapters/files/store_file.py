"""File with the store's URL. It may contain a password, because only its owner can read it."""

import stat
from pathlib import Path
from urllib.parse import urlsplit

from companion.core.base.errors import LeewayError


def read_private_store_url(path: Path) -> str:
    """Return the URL. Raises LeewayError if others can read the file or it is not one line."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        lines = path.read_text(encoding="utf-8").split()
    except (OSError, UnicodeDecodeError) as error:
        raise LeewayError(f"--store-file {path}: {error}") from error
    if mode & 0o077:
        raise LeewayError(f"--store-file {path}: mode {mode:04o}, expected 0600: chmod 600 {path}")
    if len(lines) != 1:
        raise LeewayError(f"--store-file {path}: {len(lines)} entries, expected one URL")
    return lines[0]


def raise_if_url_has_password(url: str) -> None:
    """Raise LeewayError if a URL on the command line contains a password."""
    try:
        password = urlsplit(url).password
    except ValueError:
        return  # not a URL: the store reports it
    if password is not None:
        raise LeewayError(
            "--store: contains a password, which every user of this machine can read (ps): put it"
            " into ~/.pgpass, or the URL into a file of mode 0600 for --store-file"
        )
