"""Day plans on disk (`day-plan/1`, JSON): written as a whole or not at all, read strictly."""

from pathlib import Path
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.core.schema.day_plan import DayPlan


def write_day_plan(path: Path, plan: DayPlan) -> None:
    """Write a plan, in place of an older one."""
    write_json(path, plan)


def write_json(path: Path, document: Any) -> None:
    """Write a JSON file, as a whole or not at all."""
    write_text(path, msgspec.json.format(msgspec.json.encode(document)).decode() + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file, as a whole or not at all."""
    fresh = path.with_name(path.name + ".new")
    try:
        fresh.write_text(text, encoding="utf-8")
        fresh.replace(path)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error


def read_day_plan(path: Path) -> DayPlan:
    """The plan of a file; LeewayError says what is wrong in it."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=DayPlan)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except (msgspec.DecodeError, LeewayError) as error:
        raise LeewayError(f"{path}: {error}") from error
