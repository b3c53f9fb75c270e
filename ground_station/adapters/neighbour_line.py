"""The desk's line into a neighbouring fleet's network, by which its tracks come to our vehicles.

It joins there with the identity that the neighbour made for us (role `neighbour`), in a session of
its own: neither network is joined to the other, and neither authority is known to the other's TLS.
Only tracks come by it, as they are, under their own keys; from cells that our vehicles are near, of
vehicles that the neighbour's roster lists, few of each. Who signed them the vehicles see.
"""

import threading
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import zenoh

from companion.core.base.errors import LeewayError
from companion.core.base.rate_limit import RateLimit
from companion.core.separation.track_cells import KEPT_S, HeardCells
from companion.fleet.envelope import OVERHEAD_BYTES
from companion.fleet.identity import Identity, identity_of
from companion.fleet.messages import LARGEST_BYTES, State
from companion.fleet.roles import NEIGHBOURS, Role
from companion.fleet.topics import VehicleKeys, track_of
from companion.fleet.trust import DAY_S
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import has_line
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.roster_share import RosterShare

FOLDER = "neighbours"
"""In the desk's identity: a folder for each neighbouring fleet, as that fleet's `pki` made it."""

TURN_S = 0.25
OPEN_AGAIN_S = 5.0
SAY_S = 10.0
"""A line has so long to stand before anything is said of it, and so often it is looked at."""

EACH_HZ, EACH_BURST = 10.0, 20.0
"""Of one vehicle, which tells five tracks a second. In a cell that nobody of ours hears none come.
"""

MOST_TRACK_BYTES = LARGEST_BYTES["track"] + OVERHEAD_BYTES
TRUCK = "truck"
PassOn = Callable[[str, bytes], None]


def neighbour_folder(identity: Path, fleet: str) -> Path:
    """Where the desk looks for the identity that a neighbouring fleet has made for it."""
    return identity / FOLDER / fleet


class NeighbourLine:
    """One neighbouring fleet. `pass_on` is called from this line's threads, with key and bytes."""

    def __init__(
        self, ours: str, fleet: str, folder: Path, pass_on: PassOn, say: Callable[[str], None]
    ) -> None:
        """`ours`: our fleet. `folder`: the identity that `fleet` has made for it.

        Raises LeewayError where that is missing or somebody else's.
        """
        self.fleet = fleet
        self._identity = _identity(ours, fleet, folder)
        self._config = read_config(self._identity.zenoh)
        self._pass_on = pass_on
        self._say = say
        self._heard: dict[str, HeardCells] = {}
        self._limits: dict[str, RateLimit] = {}
        self._held: dict[str, zenoh.Subscriber[None]] = {}
        self._lock = threading.Lock()
        self._trouble = ""
        self._stands = False
        self._said: bool | None = None
        self._look_s = monotonic_s() + SAY_S
        self._warned_s: float | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"line-{fleet}", daemon=True)
        self._thread.start()

    def keys(self) -> Mapping[str, str]:
        """The public keys of that fleet's vehicles that are not revoked, by name."""
        members = self._identity.trust.roster.members
        return {m.name: m.key for m in members if m.role is Role.VEHICLE and not m.revoked}

    def be_near(self, state: State) -> None:
        """Bring tracks from the cells about this vehicle of ours, for as long as it tells."""
        if state.lat_deg is None or state.lon_deg is None or state.airframe == TRUCK:
            return
        with self._lock:
            cells = self._heard.get(state.vehicle, HeardCells())
            self._heard[state.vehicle] = cells.at(state.lat_deg, state.lon_deg, monotonic_s())

    def turn(self, now_s: float) -> None:
        """Say whether the line stands, when that changes, and once a day of a certificate's end."""
        if now_s < self._look_s:
            return
        self._look_s = now_s + SAY_S
        if self._stands != self._said:
            self._said = self._stands
            words = "is reached: drones keep apart where each names the other, with --keep-apart"
            if not self._stands:
                trouble = f" ({self._trouble})" if self._trouble else ""
                words = f"IS NOT REACHED{trouble}: nothing keeps our drones and its apart"
            self._say(f"neighbour {self.fleet} {words}")
        if self._warned_s is None or now_s - self._warned_s >= DAY_S:
            self._warned_s = now_s
            if warning := self._identity.trust.warning():
                self._say(f"neighbour {self.fleet}: {warning}")

    def close(self) -> None:
        """Leave that network."""
        self._stop.set()
        self._thread.join(timeout=5.0)

    # --- the thread ----------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                with zenoh.open(self._config) as session:
                    self._serve(session)
            except zenoh.ZError as error:
                self._trouble = str(error)
            self._stands = False
            self._held.clear()
            self._stop.wait(OPEN_AGAIN_S)

    def _serve(self, session: zenoh.Session) -> None:
        share = RosterShare(session, self._identity, self._refuse)
        while not self._stop.wait(TURN_S):
            share.turn(monotonic_s())
            self._stands = has_line(session)
            self._listen(session)

    def _listen(self, session: zenoh.Session) -> None:
        """To the new cells first, then no more to those that all have left."""
        now_s = monotonic_s()
        with self._lock:
            self._heard = {n: c for n, c in self._heard.items() if now_s - c.looked_s <= KEPT_S}
            wanted = {cell for cells in self._heard.values() for cell in cells.near_s}
        for cell in wanted - self._held.keys():
            key = VehicleKeys(self.fleet, "*").track(cell)
            self._held[cell] = session.declare_subscriber(key, self._hear)
        for cell in self._held.keys() - wanted:
            self._held.pop(cell).undeclare()

    def _hear(self, sample: zenoh.Sample) -> None:
        key, raw = str(sample.key_expr), sample.payload.to_bytes()
        found = track_of(key)
        if found is None or len(raw) > MOST_TRACK_BYTES or not self._may_pass(found[0]):
            return
        self._pass_on(key, raw)

    def _may_pass(self, vehicle: str) -> bool:
        member = self._identity.trust.roster.by_name.get(vehicle)
        if member is None or member.revoked or member.role is not Role.VEHICLE:
            return False
        with self._lock:
            limit = self._limits.setdefault(vehicle, RateLimit(EACH_HZ, EACH_BURST))
            return limit.take(monotonic_s())

    def _refuse(self, why: str) -> None:
        self._trouble = why


def open_lines(
    ours: str, identity: Path, fleets: list[str], pass_on: PassOn, say: Callable[[str], None]
) -> list[NeighbourLine]:
    """A line to each neighbouring fleet. LeewayError, and none, where one cannot be opened."""
    checked = [(fleet, neighbour_folder(identity, fleet)) for fleet in fleets]
    for fleet, folder in checked:
        _identity(ours, fleet, folder)
    open_line = partial(NeighbourLine, pass_on=pass_on, say=say)
    return [open_line(ours, fleet, folder) for fleet, folder in checked]


def _identity(ours: str, fleet: str, folder: Path) -> Identity:
    if not folder.is_dir():
        raise LeewayError(
            f"neighbour {fleet}: {folder}: no such folder: expected the one that"
            f" `ground-station pki add {ours} --role neighbour` of {fleet} has made"
        )
    found = identity_of(folder, fleet, ours)
    me = found.trust.me
    if me is not None and me.role not in NEIGHBOURS:
        raise LeewayError(f"{folder}: {ours} is a {me.role.value} there, expected a neighbour")
    return found
