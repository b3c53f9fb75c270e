"""Mission upload and download (MAVLink mission protocol) with repetitions.

The upload sends items in the order of the autopilot's requests. Every message is repeated each
`RETRY_S` until its response, whatever the round trip: the autopilots end a transfer after 5 s (PX4)
or 8 s (ArduPilot) without a message, in which a slow link needs more than two attempts.
"""

from collections.abc import Callable, Sequence
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, mavlink
from companion.adapters.autopilots.mission_wire import (
    WireItem,
    decode_mission_item,
    encode_mission_items,
)
from companion.adapters.autopilots.telemetry import AutopilotProfile
from companion.core.mission.actions import ClearMission, UploadMission, VerifyMission
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import (
    Event,
    MissionProgress,
    MissionUploaded,
    MissionVerified,
    Position,
)
from companion.core.mission.mission_items import MissionItem, MissionPosition, mission_differences

RETRY_S, MAX_TRIES = CommandKind.UPLOAD.value.interval_s, CommandKind.UPLOAD.value.max_tries
MAX_MISSION_ITEMS = 700
MISSION_MESSAGES = (
    *("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_COUNT", "MISSION_ITEM_INT"),
    "MISSION_ACK",
)

MISSION_RESULT = {
    getattr(mavlink, name): name.removeprefix("MAV_MISSION_").lower().replace("_", " ")
    for name in dir(mavlink)
    if name.startswith("MAV_MISSION_")
    and isinstance(getattr(mavlink, name), int)
    and not name.startswith(("MAV_MISSION_TYPE", "MAV_MISSION_RESULT"))
}


OTHER_TRANSFER = (
    mavlink.MAV_MISSION_ERROR,
    mavlink.MAV_MISSION_INVALID_SEQUENCE,
    mavlink.MAV_MISSION_DENIED,
    mavlink.MAV_MISSION_OPERATION_CANCELLED,
)
"""Results that may belong to a repeated item, an earlier transfer or another station's transfer.
ArduPilot denies uploads and read-backs during another station's upload."""

PAUSE_S = 6.0
"""Pause after an error, in which requests and results of the old transfer arrive, and PX4 ends it:
5 s after the last message, so that messages in the pause would prolong it."""

RESTARTS = 3


class MissionUpload:
    """Uploads a mission on the autopilot's requests until it ends; `result_text` is then `""` or
    an error.

    PX4 ignores a repeated item, ArduPilot responds with INVALID_SEQUENCE; both continue the
    transfer. Another result in `OTHER_TRANSFER`, or an acceptance before the last item, counts only
    if no request follows: the upload then restarts after a pause, in which messages of the old
    transfer are discarded. After the last item the read-back decides, as the acceptance may be
    lost. Without items it clears the mission. Starts at `earliest_start_s`.
    """

    def __init__(
        self,
        send: Callable[[Any], None],
        target_system_id: int,
        items: Sequence[WireItem],
        t_s: float,
        earliest_start_s: float = 0.0,
    ) -> None:
        self._send = send
        self._target = target_system_id
        self._items = list(items)
        self._tries = 0
        self._restarts = 0
        self._error: str | None = None
        self._requested_seq = -1
        self._is_announced = False
        self._next_try_s = max(earliest_start_s, t_s)
        self.result_text: str | None = None
        self.tick(t_s)

    @property
    def are_all_items_sent(self) -> bool:
        """Whether the mission onboard may already be this one."""
        return 0 <= self._requested_seq == len(self._items) - 1

    def _send_count_item_or_clear_all(self, t_s: float) -> None:
        self._tries += 1
        self._next_try_s = t_s + RETRY_S
        self._is_announced = True
        seq, target = self._requested_seq, (self._target, AUTOPILOT)
        if not self._items:
            self._send(mavlink.MAVLink_mission_clear_all_message(*target, 0))
        elif seq < 0:
            self._send(mavlink.MAVLink_mission_count_message(*target, len(self._items), 0))
        else:
            item = self._items[seq]
            content = item.frame, item.command, 0, 1, *item.params, item.x, item.y, item.z, 0
            self._send(mavlink.MAVLink_mission_item_int_message(*target, seq, *content))

    def on_message(self, message: Any, t_s: float) -> None:
        """Process MISSION_REQUEST, MISSION_REQUEST_INT or MISSION_ACK."""
        is_other_type = getattr(message, "mission_type", 0) != 0
        if self.result_text is not None or is_other_type or not self._is_announced:
            return
        last = min(len(self._items) - 1, self._requested_seq + 1)
        match message.get_type():
            case "MISSION_ACK":
                self._process_mission_ack_result(message.type, t_s)
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT" if 0 <= message.seq <= last:
                self._send_item_unless_repeated_request(message.seq, t_s)
            case _:
                return

    def _process_mission_ack_result(self, result: int, t_s: float) -> None:
        is_accepted = result == mavlink.MAV_MISSION_ACCEPTED
        if is_accepted and self._requested_seq == len(self._items) - 1:
            self.result_text = ""
        elif result == mavlink.MAV_MISSION_INVALID_SEQUENCE:
            return
        elif self._items and (is_accepted or result in OTHER_TRANSFER):
            self._error = MISSION_RESULT[result]
            self._next_try_s = t_s + PAUSE_S
        else:
            self.result_text = MISSION_RESULT.get(result, f"result {result}")

    def _send_item_unless_repeated_request(self, seq: int, t_s: float) -> None:
        if seq == self._requested_seq and self._error is None:
            return  # the item is repeated anyway
        if seq != self._requested_seq:
            self._tries = 0
        self._requested_seq, self._error = seq, None
        self._send_count_item_or_clear_all(t_s)

    def tick(self, t_s: float) -> None:
        """Repeat the count or the last item; restart after an error."""
        if self.result_text is not None or t_s < self._next_try_s:
            return
        if self._error is None and self._tries < MAX_TRIES:
            self._send_count_item_or_clear_all(t_s)
        elif self.are_all_items_sent:
            self.result_text = ""
        elif self._error is None or self._restarts >= RESTARTS:
            seq = self._requested_seq
            at = "the mission's count" if seq < 0 else f"item {seq}"
            self.result_text = self._error or f"no response to {at}"
        else:
            self._restarts += 1
            self._error, self._requested_seq, self._tries = None, -1, 0
            self._send_count_item_or_clear_all(t_s)


class MissionDownload:
    """Requests every item; `result_text` `""`: `received_items_without_home` is the mission.

    `item_interval_s`: interval between an item and the request for the next one. `mission_type`:
    the mission, or the list of fence items or rally points (MAV_MISSION_TYPE).
    """

    def __init__(
        self,
        send: Callable[[Any], None],
        target_system_id: int,
        home_item_count: int,
        t_s: float,
        item_interval_s: float = 0.0,
        max_pending_requests: int = 1,
        mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION,
    ) -> None:
        self._type = mission_type
        self._pace_s = item_interval_s
        self._window = max_pending_requests
        self._requested_count = 0
        self._send = send
        self._target = target_system_id
        self._home_items = home_item_count
        self._count: int | None = None
        self._received: dict[int, Any] = {}
        self._tries = 0
        self._restarts = 0
        self._error: str | None = None
        self.result_text: str | None = None
        self._send_list_or_item_requests(t_s)

    @property
    def received_items_without_home(self) -> tuple[MissionItem, ...]:
        """The items received so far, without the autopilot's home item."""
        return tuple(
            decode_mission_item(message, home_item_count=self._home_items)
            for message in self.received_messages_without_home
        )

    @property
    def received_messages_without_home(self) -> tuple[Any, ...]:
        """The MISSION_ITEM_INT of these items."""
        return tuple(
            self._received[seq] for seq in sorted(self._received) if seq >= self._home_items
        )

    def _send_list_or_item_requests(self, t_s: float) -> None:
        self._tries += 1
        self._next_try_s = t_s + RETRY_S
        if self._count is None:
            self._send(
                mavlink.MAVLink_mission_request_list_message(self._target, AUTOPILOT, self._type)
            )
            return
        first = max(len(self._received), self._requested_count if self._tries == 1 else 0)
        self._requested_count = min(len(self._received) + self._window, self._count)
        for seq in range(first, self._requested_count):
            message = mavlink.MAVLink_mission_request_int_message
            self._send(message(self._target, AUTOPILOT, seq, self._type))

    def on_message(self, message: Any, t_s: float) -> None:
        """Process MISSION_COUNT, MISSION_ITEM_INT or MISSION_ACK."""
        if self.result_text is not None or getattr(message, "mission_type", 0) != self._type:
            return
        match message.get_type():
            case "MISSION_COUNT" if self._count is None:
                self._count = int(message.count)
                if self._count > MAX_MISSION_ITEMS:
                    self.result_text = f"{self._count} items onboard: more than {MAX_MISSION_ITEMS}"
            case "MISSION_ITEM_INT" if self._count is not None and message.seq == len(
                self._received
            ):
                self._received[message.seq] = message
            case "MISSION_ACK" if message.type in OTHER_TRANSFER:
                self._error = MISSION_RESULT[message.type]
                self._next_try_s = t_s + PAUSE_S
                return
            case "MISSION_ACK" if message.type != mavlink.MAV_MISSION_ACCEPTED:
                self.result_text = MISSION_RESULT.get(message.type, f"result {message.type}")
            case _:
                return
        if self.result_text is not None:
            return
        self._tries, self._error = 0, None
        if len(self._received) == self._count:
            self.result_text = ""
            self._send_mission_ack(mavlink.MAV_MISSION_ACCEPTED)
        elif self._pace_s > 0.0:
            self._next_try_s = t_s + self._pace_s
        else:
            self._send_list_or_item_requests(t_s)

    def cancel(self) -> None:
        """Cancel the download: PX4 accepts no other transfer before that."""
        self._send_mission_ack(mavlink.MAV_MISSION_OPERATION_CANCELLED)

    def _send_mission_ack(self, result: int) -> None:
        self._send(mavlink.MAVLink_mission_ack_message(self._target, AUTOPILOT, result, self._type))

    def tick(self, t_s: float) -> None:
        """Request the next item when it is due, or repeat the request after a timeout."""
        if self.result_text is not None or t_s < self._next_try_s:
            return
        if self._error is not None and self._restarts < RESTARTS:
            self._restarts += 1
            self._error, self._count, self._tries, self._requested_count = None, None, 0, 0
            self._received.clear()
        elif self._error is not None or self._tries >= MAX_TRIES:
            self.result_text = self._error or "no response to the download"
            return
        self._send_list_or_item_requests(t_s)


class MissionClient:
    """Runs one transfer at a time: a new order replaces the present one, which reports nothing.
    After a failed upload, the next one starts after a pause.

    The first position of the vehicle is the home item of uploaded missions.
    """

    def __init__(
        self, send: Callable[[Any], None], system_id: int, profile: AutopilotProfile
    ) -> None:
        self._send = send
        self._system_id = system_id
        self._profile = profile
        self._transfer: MissionUpload | MissionDownload | None = None
        self._upload_not_before_s = 0.0
        self._verified = VerifyMission(())
        self._home: MissionPosition | None = None
        self._mission_id: int | None = None

    def record_first_position(self, position: Position) -> None:
        """Record the vehicle's first position."""
        if self._home is None:
            self._home = MissionPosition(position.lat_deg, position.lon_deg, position.alt_amsl_m)

    def start_transfer(
        self, order: UploadMission | ClearMission | VerifyMission, t_s: float
    ) -> None:
        """Start the transfer of an order."""
        send, system_id, profile = self._send, self._system_id, self._profile
        self._mission_id = None  # the next report may still be of an earlier change
        match order:
            case UploadMission():
                wire = encode_mission_items(
                    order.items,
                    home_item_count=profile.home_item_count,
                    home=self._home or MissionPosition(0.0, 0.0, 0.0),
                    autopilot_chosen_yaw_value=profile.free_yaw,
                )
                self._transfer = MissionUpload(
                    send, system_id, wire, t_s, self._upload_not_before_s
                )
            case ClearMission():
                self._transfer = MissionUpload(send, system_id, (), t_s)
            case VerifyMission():
                self._verified = order
                window = order.pending_requests if profile.supports_parallel_reads else 1
                self._transfer = MissionDownload(
                    send, system_id, profile.home_item_count, t_s, order.item_interval_s, window
                )

    def cancel(self) -> None:
        """Stop the transfer without a report."""
        self._transfer = None

    def end_upload_if_id_changed(self, progress: MissionProgress) -> list[Event]:
        """End an upload if the mission's ID (PX4) changes before the autopilot has all items."""
        before, self._mission_id = self._mission_id, progress.mission_id
        is_changed = None not in (before, self._mission_id) and before != self._mission_id
        upload = self._transfer if isinstance(self._transfer, MissionUpload) else None
        is_foreign = is_changed and upload is not None and not upload.are_all_items_sent
        return self.end_upload_written_by_other(progress.t_s) if is_foreign else []

    def end_upload_written_by_other(self, t_s: float) -> list[Event]:
        """End an upload or clearing: another station has written the mission."""
        if not isinstance(self._transfer, MissionUpload):
            return []
        self._transfer = None
        return [MissionUploaded(t_s, "written by another station", superseded=True)]

    def on_message(self, message: Any, t_s: float) -> list[Event]:
        """Process one of `MISSION_MESSAGES`; return the event of a transfer that it ends."""
        if self._transfer is not None:
            self._transfer.on_message(message, t_s)
        return self._take_ended_events(t_s)

    def tick(self, t_s: float) -> list[Event]:
        """Repeat what is due; return the event of a transfer that ended."""
        if self._transfer is not None:
            self._transfer.tick(t_s)
        return self._take_ended_events(t_s)

    def _take_ended_events(self, t_s: float) -> list[Event]:
        transfer = self._transfer
        if transfer is None:
            return []
        result_text = transfer.result_text
        if isinstance(transfer, MissionUpload):
            if result_text is None:
                return []
            self._transfer = None
            if result_text:
                self._upload_not_before_s = t_s + PAUSE_S
            return [MissionUploaded(t_s, result_text or None)]
        if result_text is None:
            return self._cancel_download_at_first_difference(transfer, t_s)
        self._transfer = None
        if result_text:
            return [MissionVerified(t_s, (result_text,), complete=False)]
        received_items = transfer.received_items_without_home
        return [MissionVerified(t_s, mission_differences(self._verified.items, received_items))]

    def _cancel_download_at_first_difference(
        self, download: MissionDownload, t_s: float
    ) -> list[Event]:
        """End a download whose newest item already differs from the expected mission."""
        so_far = download.received_items_without_home
        if not self._verified.stop_at_first_difference or not so_far:
            return []
        at = len(so_far) - 1
        found = mission_differences(self._verified.items[at : at + 1], so_far[at:])
        if not found:
            return []
        download.cancel()
        self._transfer = None
        return [MissionVerified(t_s, found)]
