"""Values of the table `about`, and the epoch among them: no id is issued twice, though a restored
copy lacks the latest ones.
"""

from typing import Any

import msgspec
import sqlalchemy as sa

from ground_station.adapters.store import tables as t
from ground_station.core.schema.orders import ROOT_CHARS


def about_value(db: sa.Connection, name: str, value_type: Any) -> Any:
    """Return a value of the table `about`; None: it is not stored."""
    query = sa.select(t.about.c.value).where(t.about.c.name == name)
    found = db.execute(query).scalar_one_or_none()
    return None if found is None else msgspec.json.decode(found, type=value_type)


def replace_about_value(db: sa.Connection, name: str, value: Any) -> None:
    """Replace a value of the table `about`; None: remove it."""
    db.execute(sa.delete(t.about).where(t.about.c.name == name))
    if value is not None:
        encoded = msgspec.json.encode(value).decode()
        db.execute(sa.insert(t.about).values(name=name, value=encoded))


def store_epoch(db: sa.Connection) -> str:
    """Return the epoch in force; empty in a store of an earlier version."""
    epochs = about_value(db, t.EPOCHS_KEY, list[str])
    return epochs[-1] if epochs else ""


def id_in_epoch(db: sa.Connection, command_id: str) -> str:
    """Return a command's id that no earlier epoch has issued: the copy may lack its commands."""
    epoch = store_epoch(db)
    if not epoch or f".{epoch}." in command_id:
        return command_id
    return f"{command_id}.{epoch[ROOT_CHARS:] if ':' in command_id else epoch}"
