"""Hand-over of a shift: notes for the next dispatcher, who accepts it by name."""

from collections.abc import Callable

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store.about_steps import about_value, replace_about_value
from ground_station.adapters.store.database import Database
from ground_station.core.schema.holds import Handover, HandoverNote

HANDOVER_KEY = "handover"
MAX_NOTES = 50


def read_handover(database: Database) -> Handover | None:
    """Return the latest hand-over; None: there was none."""
    return database.about_value(HANDOVER_KEY, Handover)


def hand_over(database: Database, epoch_us: Callable[[], int], by: str, note: str) -> str:
    """Hand over with a note, in addition to those that nobody has accepted; returns the result."""
    now_us = epoch_us()
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        before = about_value(db, HANDOVER_KEY, Handover)
        notes = [] if before is None or before.accepted_by else before.notes
        notes = [*notes, HandoverNote(now_us, by, note)][-MAX_NOTES:]
        replace_about_value(db, HANDOVER_KEY, Handover(by=by, at_us=now_us, notes=notes))
        audit.add_entry(db, now_us, by, "hand_over", "shift", note)
    return f"handed over by {by}: the next dispatcher accepts it"


def accept_handover(database: Database, epoch_us: Callable[[], int], by: str) -> str:
    """Accept the hand-over; returns the result. Raises LeewayError if there is none, or it is the
    person's own.
    """
    now_us = epoch_us()
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        found = about_value(db, HANDOVER_KEY, Handover)
        if found is None or found.accepted_by:
            raise LeewayError(
                "no hand-over waits: `ground-station handover --note TEXT` begins one"
            )
        if found.by == by:
            raise LeewayError(f"handed over by {by}: expected another person to accept it")
        accepted = msgspec.structs.replace(found, accepted_by=by, accepted_us=now_us)
        replace_about_value(db, HANDOVER_KEY, accepted)
        audit.add_entry(db, now_us, by, "accept_handover", "shift", f"from {found.by}")
    return f"accepted by {by} from {found.by}"
