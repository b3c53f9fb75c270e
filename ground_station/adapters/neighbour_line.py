"""Desk's connection to a neighbouring fleet's network: brings its tracks to own vehicles.

It joins with the identity that the neighbour issued for this fleet (role `neighbour`), in a session
of its own. Neither network is joined to the other, and neither TLS trusts the other's authority.
Only tracks pass, unchanged and under their own keys: from cells near own vehicles, of vehicles on
the neighbour's roster, rate-limited per vehicle. The vehicles check the signatures.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import zenoh

from companion.core.base.errors import LeewayError
from companion.core.base.rate_limit import RateLimit
from companion.core.separation.track_cells import CELL_LIFETIME_S, SubscribedCells
from companion.fleet.envelope import MAX_OVERHEAD_BYTES
from companion.fleet.identity import MemberIdentity, read_identity_of_fleet_and_member
from companion.fleet.messages import MAX_MESSAGE_BYTES, State
from companion.fleet.roles import NEIGHBOURS, Role
from companion.fleet.topics import VehicleKeys, vehicle_and_cell_from_key
from companion.fleet.trust import DAY_S
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_session import KeySubscriptions, SessionThread, is_connected
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.roster_share import RosterShare

NEIGHBOURS_FOLDER = "neighbours"
"""Folder in the desk's identity, with a subfolder per neighbour, made by that fleet's `pki`."""

CYCLE_S = 0.25
STATUS_INTERVAL_S = 10.0
"""Interval between status checks; also the delay before the first status message."""

VEHICLE_RATE_HZ, VEHICLE_BURST = 10.0, 20.0
"""Per vehicle, which sends five tracks per second. Cells without an own vehicle are not subscribed
to.
"""

MAX_TRACK_BYTES = MAX_MESSAGE_BYTES["track"] + MAX_OVERHEAD_BYTES
TRUCK = "truck"
ForwardTrack = Callable[[str, bytes], None]


def neighbour_identity_folder(identity_folder: Path, fleet: str) -> Path:
    """Return the folder of the identity that a neighbouring fleet issued for this desk."""
    return identity_folder / NEIGHBOURS_FOLDER / fleet


class NeighbourConnection:
    """Connection to one neighbouring fleet. Its threads call `forward_track` (key, payload)."""

    def __init__(
        self,
        own_fleet: str,
        neighbour_fleet: str,
        identity_folder: Path,
        forward_track: ForwardTrack,
        log_message: Callable[[str], None],
    ) -> None:
        """`own_fleet`: this fleet's name. `identity_folder`: the identity `neighbour_fleet` issued
        for it.

        Raises LeewayError if the identity is missing or was issued for another fleet.
        """
        self.fleet = neighbour_fleet
        self._identity = _read_neighbour_identity(own_fleet, neighbour_fleet, identity_folder)
        self._forward_track = forward_track
        self._say = log_message
        self._searched_cells: dict[str, SubscribedCells] = {}
        self._limits: dict[str, RateLimit] = {}
        self._lock = threading.Lock()
        self._is_connected = False
        self._reported_connected: bool | None = None
        self._next_status_s = monotonic_s() + STATUS_INTERVAL_S
        self._warned_s: float | None = None
        self._session_thread = SessionThread(
            f"line-{neighbour_fleet}",
            read_and_check_zenoh_config(self._identity.zenoh_config_path),
            self._run_session_until_stopped,
        )
        self._session_thread.start()

    def valid_vehicle_public_keys_by_name(self) -> Mapping[str, str]:
        """Return the public keys of that fleet's vehicles that are not revoked, by name."""
        members = self._identity.trust.roster.members
        return {m.name: m.key for m in members if m.role is Role.VEHICLE and not m.revoked}

    def subscribe_near_own_vehicle(self, state: State) -> None:
        """Subscribe to tracks in the cells around this own vehicle while it sends states."""
        if state.lat_deg is None or state.lon_deg is None or state.airframe == TRUCK:
            return
        with self._lock:
            cells = self._searched_cells.get(state.vehicle, SubscribedCells())
            self._searched_cells[state.vehicle] = cells.updated_for_position(
                state.lat_deg, state.lon_deg, monotonic_s()
            )

    def report_connection_and_certificate(self, now_s: float) -> None:
        """Report connection changes, and once a day a certificate that ends soon."""
        if now_s < self._next_status_s:
            return
        self._next_status_s = now_s + STATUS_INTERVAL_S
        if self._is_connected != self._reported_connected:
            self._reported_connected = self._is_connected
            words = "connected: drones keep separation if both fleets use --keep-apart"
            if not self._is_connected:
                error = self._session_thread.error_text
                error_text = f" ({error})" if error else ""
                words = f"NOT CONNECTED{error_text}: no separation from its drones"
            self._say(f"neighbour {self.fleet} {words}")
        if self._warned_s is None or now_s - self._warned_s >= DAY_S:
            self._warned_s = now_s
            if warning := self._identity.trust.certificate_warning_or_empty():
                self._say(f"neighbour {self.fleet}: {warning}")

    def close(self) -> None:
        """Leave that network."""
        self._session_thread.close()

    # --- the thread ----------------------------------------------------------------------------

    def _run_session_until_stopped(self, session: zenoh.Session) -> None:
        share = RosterShare(session, self._identity, self._record_roster_rejection)
        subscriptions = KeySubscriptions(session)
        try:
            while not self._session_thread.stop.wait(CYCLE_S):
                share.poll_file_and_exchange_rosters(monotonic_s())
                self._is_connected = is_connected(session)
                subscriptions.update_keys(
                    dict.fromkeys(self._required_track_keys(), self._forward_track_if_permitted)
                )
        finally:
            self._is_connected = False

    def _required_track_keys(self) -> set[str]:
        """Return the keys of tracks in cells that own vehicles are near."""
        now_s = monotonic_s()
        with self._lock:
            self._searched_cells = {
                n: c
                for n, c in self._searched_cells.items()
                if now_s - c.searched_s <= CELL_LIFETIME_S
            }
            cells = {cell for cells in self._searched_cells.values() for cell in cells.near_s}
        return {VehicleKeys(self.fleet, "*").track_key(cell) for cell in cells}

    def _forward_track_if_permitted(self, sample: zenoh.Sample) -> None:
        key, raw = str(sample.key_expr), sample.payload.to_bytes()
        found = vehicle_and_cell_from_key(key)
        if (
            found is None
            or len(raw) > MAX_TRACK_BYTES
            or not self._is_vehicle_valid_and_within_rate(found[0])
        ):
            return
        self._forward_track(key, raw)

    def _is_vehicle_valid_and_within_rate(self, vehicle: str) -> bool:
        member = self._identity.trust.roster.member_by_name.get(vehicle)
        if member is None or member.revoked or member.role is not Role.VEHICLE:
            return False
        with self._lock:
            limit = self._limits.setdefault(vehicle, RateLimit(VEHICLE_RATE_HZ, VEHICLE_BURST))
            return limit.try_consume_tokens(monotonic_s())

    def _record_roster_rejection(self, reason: str) -> None:
        self._session_thread.error_text = reason


def open_neighbour_connections(
    identity: MemberIdentity,
    fleets: Sequence[str],
    forward_track: ForwardTrack,
    log_message: Callable[[str], None],
) -> dict[str, NeighbourConnection]:
    """Open the connection of this desk to each of these fleets; returns them by fleet.

    Raises LeewayError, and opens none, if one fails.
    """
    trust = identity.trust
    for fleet in set(fleets) - set(trust.roster.neighbour_fleet_names):
        log_message(
            f"neighbour {fleet}: not on this fleet's roster, its tracks are blocked:"
            f" run `ground-station pki add {fleet} --role neighbour` in this fleet's folder"
        )
    folders = {fleet: neighbour_identity_folder(identity.folder, fleet) for fleet in fleets}
    for fleet, folder in folders.items():
        _read_neighbour_identity(trust.fleet, fleet, folder)
    return {
        fleet: NeighbourConnection(trust.fleet, fleet, folder, forward_track, log_message)
        for fleet, folder in folders.items()
    }


def _read_neighbour_identity(own_fleet: str, fleet: str, folder: Path) -> MemberIdentity:
    if not folder.is_dir():
        raise LeewayError(
            f"neighbour {fleet}: {folder}: no such folder: expected the one made by"
            f" `ground-station pki add {own_fleet} --role neighbour` in fleet {fleet}"
        )
    found = read_identity_of_fleet_and_member(folder, fleet, own_fleet)
    me = found.trust.own_roster_entry
    if me is not None and me.role not in NEIGHBOURS:
        raise LeewayError(f"{folder}: {own_fleet} is a {me.role.value} there, expected a neighbour")
    return found
