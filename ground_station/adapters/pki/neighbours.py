"""Fleets of one operator made neighbours of one another: each gets what its desk needs of others.

Fleets of two operators do the same by hand: each makes a member of role `neighbour` in the name of
the other's fleet, and gives its folder to the other's desk (docs/how-to/large-days.md).
"""

import itertools
from collections.abc import Sequence
from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.fleet.identity import read_bytes
from companion.fleet.roles import NEIGHBOURS, Role
from ground_station.adapters.neighbour_line import FOLDER, neighbour_folder
from ground_station.adapters.pki.pki_folder import (
    MEMBERS,
    PkiFolder,
    private_folder,
    write_file,
)


def introduce(fleets: Sequence[PkiFolder], days: int) -> list[Path]:
    """Make each a neighbour of all others; the folders that desks got, each within its desk's.

    Who is a neighbour already stays so with the same keys, and its folder is copied anew. Raises
    LeewayError, before anything is made, where fleets or members cannot be told apart, or one has
    no desk.
    """
    names = [one.roster.fleet for one in fleets]
    if len(set(names)) < len(names):
        raise LeewayError(f"neighbours: expected fleets of different names, not {', '.join(names)}")
    new = {one.roster.fleet: _new_names(one, names) for one in fleets}
    for one in fleets:
        if not _desks(one):
            raise LeewayError(f"{one.folder}: no desk on the roster: expected one first")
    for one in fleets:
        if new[one.roster.fleet]:
            one.add_all(new[one.roster.fleet], Role.NEIGHBOUR, days)
    return [
        _carry(giver, taker, desk)
        for giver, taker in itertools.permutations(fleets, 2)
        for desk in _desks(taker)
    ]


def _new_names(one: PkiFolder, names: Sequence[str]) -> list[str]:
    """Neighbours that it does not know yet."""
    found: list[str] = []
    for name in names:
        known = one.roster.by_name.get(name)
        if known is not None and known.role not in NEIGHBOURS and name != one.roster.fleet:
            raise LeewayError(f"{one.folder}: {name} is a {known.role.value}: expected a neighbour")
        if name != one.roster.fleet and (known is None or known.revoked):
            found.append(name)
    return found


def _desks(one: PkiFolder) -> list[str]:
    return [m.name for m in one.roster.members if m.role is Role.DESK and not m.revoked]


def _carry(giver: PkiFolder, taker: PkiFolder, desk: str) -> Path:
    """What the giver's authority made for the taker's fleet, into the folder of this desk."""
    source = giver.folder / MEMBERS / taker.roster.fleet
    home = taker.folder / MEMBERS / desk
    there = neighbour_folder(home, giver.roster.fleet)
    private_folder(home / FOLDER)
    private_folder(there)
    for file in sorted(source.iterdir()):
        write_file(there / file.name, read_bytes(file), file.stat().st_mode & 0o777)
    return there
