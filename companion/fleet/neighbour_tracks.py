"""Tracks of nearby vehicles, of the own and of neighbouring fleets, as received from zenoh."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial

import zenoh

from companion.core.mission.flight_file import NeighbourFleet
from companion.core.separation.track_cells import SubscribedCells
from companion.fleet.network import ReceivedTrack
from companion.fleet.topics import VehicleKeys, vehicle_and_cell_from_key
from companion.fleet.zenoh_session import KeySubscriptions, wrap_as_direct_callback

MAX_TRACKED_NEIGHBOURS = 256
"""Maximum neighbours per fleet with stored tracks, so that no fleet's flood displaces another's
tracks.
"""

MAX_TRACKS_PER_NEIGHBOUR = 8
"""Maximum tracks per neighbour, which sends five a second: signatures are verified later, so a
forged track after the valid one does not replace it. A verification takes 0.1 ms.
"""


class TrackReceiver:
    """Stored tracks, and the subscriptions to the cells around the own position.

    zenoh's threads store tracks and the flight's thread removes them, under `_tracks_lock`. The
    flight's thread replaces position and neighbours, each in one assignment, and the other threads
    read them; the session's thread alone uses cells and subscriptions.
    """

    def __init__(self, keys: VehicleKeys, is_member: Callable[[str], bool]) -> None:
        """`is_member`: True for senders of the own fleet whose tracks are stored."""
        self._keys = keys
        self._is_member = is_member
        self._tracks: dict[str, dict[str, deque[ReceivedTrack]]] = {}
        self._tracks_lock = threading.Lock()
        self._position_deg: tuple[float, float] | None = None
        self._neighbours: dict[str, NeighbourFleet] = {}
        self._subscriptions: KeySubscriptions | None = None
        self._cells = SubscribedCells()
        self._fleets: Sequence[str] = ()

    def drain_tracks(self) -> list[ReceivedTrack]:
        """Return the newest tracks of each neighbour since the last call; oldest first for each."""
        with self._tracks_lock:
            received, self._tracks = self._tracks, {}
        return [track for fleet in received.values() for each in fleet.values() for track in each]

    def set_position(self, lat_deg: float, lon_deg: float) -> None:
        """Set the position; the session's thread subscribes to the cells around it."""
        self._position_deg = lat_deg, lon_deg

    def set_neighbour_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        """Set the fleets whose tracks are received; the own fleet is ignored."""
        self._neighbours = {one.fleet: one for one in neighbours if one.fleet != self._keys.fleet}

    def begin_session(self, session: zenoh.Session) -> None:
        """Forget the subscriptions of an earlier session."""
        self._subscriptions = KeySubscriptions(session)
        self._cells, self._fleets = SubscribedCells(), ()

    def update_subscriptions(self, now_s: float) -> None:
        """Subscribe to the cells around the newest position, the own fleet's first."""
        if (position_deg := self._position_deg) is None or self._subscriptions is None:
            return
        cells = self._cells.updated_for_position(*position_deg, now_s)
        fleets = ("", *self._neighbours)
        if cells is self._cells and fleets == self._fleets:
            return
        self._cells, self._fleets = cells, fleets
        self._subscriptions.update_keys(
            {
                self._keys.fleet_tracks_key(cell, fleet): wrap_as_direct_callback(
                    partial(self._store_track_of_accepted_sender, fleet)
                )
                for fleet in fleets
                for cell in cells.near_s
            }
        )

    def _store_track_of_accepted_sender(self, fleet: str, sample: zenoh.Sample) -> None:
        key = vehicle_and_cell_from_key(str(sample.key_expr))
        if key is None:
            return
        sender, cell = key
        if not self._is_track_sender_accepted(fleet, sender):
            return
        received = ReceivedTrack(sender, cell, sample.payload.to_bytes(), fleet)
        with self._tracks_lock:
            boxes = self._tracks.setdefault(fleet, {})
            box = boxes.get(sender)
            if box is None:
                if len(boxes) >= MAX_TRACKED_NEIGHBOURS:
                    return
                box = boxes[sender] = deque(maxlen=MAX_TRACKS_PER_NEIGHBOUR)
            box.append(received)

    def _is_track_sender_accepted(self, fleet: str, sender: str) -> bool:
        """Return True if tracks of this sender are stored until their signature is verified."""
        if not fleet:
            return sender != self._keys.vehicle and self._is_member(sender)
        neighbour = self._neighbours.get(fleet)
        return neighbour is not None and (not neighbour.keys or sender in neighbour.keys)
