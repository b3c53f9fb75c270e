"""A member's link in memory, for tests."""

from collections.abc import Callable, Sequence

import msgspec

from companion.core.mission.flight_file import NeighbourFleet
from companion.fleet.command_log import MAX_LAUNCH_VALIDITY_S
from companion.fleet.messages import (
    CommandAction,
    FleetEvent,
    Launch,
    LaunchWindow,
    State,
    decode_message,
)
from companion.fleet.network import MemberRequest, ReceivedTrack


def valid_from(deed: CommandAction, life: str, uptime_s: float) -> CommandAction:
    """Return the command; a launch without a validity gets one from this uptime on."""
    if not isinstance(deed, Launch) or isinstance(deed.window, LaunchWindow):
        return deed
    expires_s = uptime_s + MAX_LAUNCH_VALIDITY_S
    window = LaunchWindow(instance_id=life, not_before_s=uptime_s, expires_s=expires_s)
    return msgspec.structs.replace(deed, window=window)


class Wire:
    """A link in memory: requests wait, published messages are kept."""

    trust = None

    def __init__(self) -> None:
        self.waiting: list[MemberRequest] = []
        self.states: list[State] = []
        self.events: list[FleetEvent] = []

    def drain_requests(self) -> list[MemberRequest]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def set_request_callback(self, wake: Callable[[], None]) -> None:
        del wake

    def publish_state(self, raw: bytes) -> None:
        state = decode_message(State, raw)
        assert isinstance(state, State)
        self.states.append(state)

    def publish_event(self, raw: bytes) -> None:
        event = decode_message(FleetEvent, raw)
        assert isinstance(event, FleetEvent)
        self.events.append(event)

    def publish_track(self, raw: bytes, cell: str) -> None:
        del raw, cell

    def subscribe_near(self, lat_deg: float, lon_deg: float) -> None:
        del lat_deg, lon_deg

    def subscribe_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        del neighbours

    def drain_tracks(self) -> list[ReceivedTrack]:
        return []

    def drain_wind_messages(self) -> list[bytes]:
        return []

    def do_all_clients_read_wind_cov(self) -> bool:
        return True

    def close(self) -> None:
        pass
