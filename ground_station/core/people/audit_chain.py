"""The audit: each row holds the digest of the row before, so that alterations are detected.

Detects a row that was altered, removed or inserted by mistake or by hand. With write access to the
whole database a new chain can be written: a digest kept elsewhere detects that.
"""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import msgspec

INITIAL_DIGEST = "0" * 64
"""Digest before the first row."""


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """Actor, action, subject, time and response.

    `who`: an operator, a desk or a vehicle. `login`: the account and computer that wrote it.
    """

    at_us: int
    who: str
    login: str
    deed: str
    subject: str
    answer: str


@dataclass(frozen=True, slots=True)
class AuditRow:
    """An entry with its number. `before`: the digest of the row before it."""

    n: int
    entry: AuditEntry
    before: str
    digest: str


@dataclass(frozen=True, slots=True)
class AuditHead:
    """Number and digest of the last row."""

    n: int = 0
    digest: str = INITIAL_DIGEST


def row_digest(row_number: int, previous_digest: str, entry: AuditEntry) -> str:
    """Return the SHA-256 of a row (number, digest before it, entry) as hexadecimal digits."""
    return hashlib.sha256(msgspec.json.encode([row_number, previous_digest, entry])).hexdigest()


def build_chained_rows(head: AuditHead, entries: Iterable[AuditEntry]) -> Iterator[AuditRow]:
    """Yield the rows of these entries after `head`."""
    n, before = head.n, head.digest
    for entry in entries:
        n += 1
        digest = row_digest(n, before, entry)
        yield AuditRow(n, entry, before, digest)
        before = digest


def find_chain_faults(
    rows: Iterable[AuditRow], expected_head: AuditHead, kept_digest: str | None = None
) -> Iterator[str]:
    """Yield the faults of the chain, by row. `kept_digest`: the head of an earlier verification."""
    last, is_kept_digest_found = AuditHead(), kept_digest in (None, INITIAL_DIGEST)
    for row in rows:
        is_kept_digest_found |= row.digest == kept_digest
        if row.n != last.n + 1:
            yield f"row {row.n}: follows row {last.n}, expected row {last.n + 1}"
        if row.digest != row_digest(row.n, row.before, row.entry):
            yield f"row {row.n}: altered: its content does not match its digest"
        if row.before != last.digest:
            yield f"row {row.n}: does not match the present row {last.n}"
        last = AuditHead(row.n, row.digest)
    if last != expected_head:
        yield f"row {last.n}: last row found, expected row {expected_head.n}"
    if not is_kept_digest_found:
        yield f"no row has the digest {kept_digest}: rows were removed, or all written anew"
