"""The audit: each row holds the digest of the one before, so none is altered unnoticed.

This finds a row that was altered, removed or put in, by a mistake or by hand. Who may write the
whole database can also write a whole new chain: so `head` is worth keeping elsewhere.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import msgspec

FIRST = "0" * 64
"""What the first row follows."""


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """Who did what to what, when, and how it was answered.

    `who`: a person, a desk or a vehicle. `login`: the account and machine that wrote it.
    """

    at_us: int
    who: str
    login: str
    deed: str
    subject: str
    answer: str


@dataclass(frozen=True, slots=True)
class AuditRow:
    """An entry in its place. `before`: the digest of the row before it."""

    n: int
    entry: AuditEntry
    before: str
    digest: str


@dataclass(frozen=True, slots=True)
class AuditHead:
    """The newest row's number and digest."""

    n: int = 0
    digest: str = FIRST


def digest_of(n: int, before: str, entry: AuditEntry) -> str:
    """SHA-256 of a row's number, its entry and the digest before it, as hexadecimal digits."""
    return hashlib.sha256(msgspec.json.encode([n, before, entry])).hexdigest()


def following(head: AuditHead, entries: Iterable[AuditEntry]) -> Iterator[AuditRow]:
    """The rows of these entries behind `head`."""
    n, before = head.n, head.digest
    for entry in entries:
        n += 1
        digest = digest_of(n, before, entry)
        yield AuditRow(n, entry, before, digest)
        before = digest


def faults(rows: Iterable[AuditRow], head: AuditHead) -> Iterator[str]:
    """What is wrong with the chain, by row; nothing where it is whole."""
    last = AuditHead()
    for row in rows:
        if row.n != last.n + 1:
            yield f"row {row.n}: follows row {last.n}, expected row {last.n + 1}"
        if row.digest != digest_of(row.n, row.before, row.entry):
            yield f"row {row.n}: altered: its content is not what was written"
        if row.before != last.digest:
            yield f"row {row.n}: does not fit what is now row {last.n}"
        last = AuditHead(row.n, row.digest)
    if last != head:
        yield f"row {last.n}: is the newest there, row {head.n} was written last"
