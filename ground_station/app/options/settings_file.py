"""`leeway-desk.toml`: defaults of the options that every command of the desk shares."""

from pathlib import Path
from typing import Any

import typer

from companion.core.base.documents import parse_toml
from companion.core.base.errors import LeewayError

SETTINGS_FILE = Path("leeway-desk.toml")
KEYS = ("store", "store_file", "user", "identity", "zenoh", "fleet")


def read_settings(file: Path) -> dict[str, str]:
    """Read a settings file. LeewayError: an unknown key, a value that is no text."""
    try:
        table = parse_toml(file.read_bytes(), str(file))
    except OSError as error:
        raise LeewayError(f"{file}: {error.strerror}") from error
    for key, value in table.items():
        if key not in KEYS:
            raise LeewayError(f"{file}: unknown key {key!r}, expected {', '.join(KEYS)}")
        if not isinstance(value, str) or not value:
            raise LeewayError(f"{file}: {key}: expected text")
    return table


def set_option_defaults_from_settings(ctx: typer.Context, file: Path | None) -> Path | None:
    """Take the defaults of the other options from the file, where there is one."""
    if file is None and SETTINGS_FILE.is_file():
        file = SETTINGS_FILE
    if file is not None and not ctx.resilient_parsing:
        defaults: dict[str, Any] = read_settings(file)
        ctx.default_map = {**(ctx.default_map or {}), **defaults}
    return file
