"""Makes fleets of one operator neighbours: each desk gets its identities in the other fleets.

Fleets of two operators do the same by hand: each adds a member of role `neighbour` named after the
other fleet, and gives its folder to the other's desk (docs/how-to/large-days.md).
"""

import itertools
from collections.abc import Sequence
from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.fleet.identity import read_file_bytes
from companion.fleet.roles import NEIGHBOURS, Role
from ground_station.adapters.files.atomic_file import write_file_atomically
from ground_station.adapters.neighbour_line import NEIGHBOURS_FOLDER, neighbour_identity_folder
from ground_station.adapters.pki.pki_folder import (
    MEMBERS_FOLDER,
    PkiFolder,
    make_private_folder,
)


def add_mutual_neighbour_identities(
    fleets: Sequence[PkiFolder], certificate_validity_days: int
) -> list[Path]:
    """Make each fleet a neighbour of all others; returns the new folders inside the desks' folders.

    Existing neighbours keep their keys, and their folders are copied again. Raises LeewayError,
    before any change, if names of fleets or members conflict, or a fleet has no desk.
    """
    names = [one.roster.fleet for one in fleets]
    if len(set(names)) < len(names):
        raise LeewayError(f"neighbours: expected fleets of different names, not {', '.join(names)}")
    new = {one.roster.fleet: _fleets_not_yet_neighbours(one, names) for one in fleets}
    for one in fleets:
        if not _active_desk_names(one):
            raise LeewayError(f"{one.folder}: no desk on the roster: add one first")
    for one in fleets:
        if new[one.roster.fleet]:
            one.add_members(new[one.roster.fleet], Role.NEIGHBOUR, certificate_validity_days)
    return [
        _copy_identity_to_desk_folder(giver, taker, desk)
        for giver, taker in itertools.permutations(fleets, 2)
        for desk in _active_desk_names(taker)
    ]


def _fleets_not_yet_neighbours(pki_folder: PkiFolder, fleet_names: Sequence[str]) -> list[str]:
    """Return the fleets that are not yet its neighbours."""
    found: list[str] = []
    for name in fleet_names:
        known = pki_folder.roster.member_by_name.get(name)
        if known is not None and known.role not in NEIGHBOURS and name != pki_folder.roster.fleet:
            raise LeewayError(
                f"{pki_folder.folder}: {name} is a {known.role.value}: expected a neighbour"
            )
        if name != pki_folder.roster.fleet and (known is None or known.revoked):
            found.append(name)
    return found


def _active_desk_names(pki_folder: PkiFolder) -> list[str]:
    return [m.name for m in pki_folder.roster.members if m.role is Role.DESK and not m.revoked]


def _copy_identity_to_desk_folder(
    source_fleet: PkiFolder, target_fleet: PkiFolder, target_desk_name: str
) -> Path:
    """Copy the giver's identity for the taker's fleet into the folder of this desk."""
    source = source_fleet.folder / MEMBERS_FOLDER / target_fleet.roster.fleet
    home = target_fleet.folder / MEMBERS_FOLDER / target_desk_name
    target = neighbour_identity_folder(home, source_fleet.roster.fleet)
    make_private_folder(home / NEIGHBOURS_FOLDER)
    make_private_folder(target)
    for file in sorted(source.iterdir()):
        write_file_atomically(
            target / file.name, read_file_bytes(file), file.stat().st_mode & 0o777
        )
    return target
