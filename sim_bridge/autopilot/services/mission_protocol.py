"""The mission protocol's server side: uploads, downloads, partial writes, clearing.

Each autopilot's differences are in its `MissionRules`; it receives changes through
`MissionWatcher`. Sources: mavlink.io/en/services/mission.html; ArduPilot,
libraries/GCS_MAVLink/MissionItemProtocol.cpp; PX4, src/modules/mavlink/mavlink_mission.cpp.
"""

import math
from dataclasses import dataclass
from typing import Any, Protocol

from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, MavFrame, MissionResult, MissionType, Severity
from sim_bridge.autopilot.mission.items import (
    NO_COORDINATE,
    POSITIONED_COMMANDS,
    MissionItem,
    MissionStore,
)
from sim_bridge.autopilot.services.mission_rules import MissionRules, Transfer
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState


class MissionWatcher(Protocol):
    """Receiver of mission changes: the autopilot."""

    def can_clear_mission(self) -> bool:
        """Return True if a mission may be cleared now."""
        ...

    def on_mission_changed(self, *, is_complete_list: bool) -> None:
        """Handle a changed mission; `is_complete_list` after a complete upload or clearing."""
        ...


@dataclass(slots=True)
class MissionProtocol:
    """One mission protocol server; all the vehicle's links share it."""

    _state: VehicleState
    _radio: Radio
    _watcher: MissionWatcher
    _rules: MissionRules
    _store: MissionStore
    _upload: Transfer | None = None
    _ended_upload: Transfer | None = None
    _download: Transfer | None = None

    def discard_transfers(self) -> None:
        """Discard transfers in progress, as a reboot does."""
        self._upload = None
        self._download = None

    # --- messages -----------------------------------------------------------------------------

    def handle_mission_count(self, link_id: int, message: Message) -> None:
        """MISSION_COUNT: an upload begins, or with 0 items is over."""
        rules = self._rules
        kind = message.mission_type
        if kind not in (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY):
            self._send_ack_to_sender(link_id, message, rules.unknown_type)
            return
        if rules.is_atomic and self._download is not None:  # PX4: one transfer at a time
            self._send_ack_to_sender(link_id, message, MissionResult.ERROR)
            return
        upload = self._upload
        if upload is not None and not (
            upload.is_from_peer(message) and (not rules.is_atomic or upload.next_seq == 0)
        ):
            if rules.is_atomic:  # PX4: prolongs the transfer
                upload.last_received_s = self._state.t_s
            self._send_ack_to_sender(link_id, message, MissionResult.ERROR)
            return
        if message.count > rules.capacity:
            self._send_ack_to_sender(link_id, message, MissionResult.NO_SPACE)
            return
        if not rules.is_atomic:
            del self._store.items_of_type(kind)[message.count :]
        if message.count == 0:
            self._upload = None
            self._store.items_of_type(kind).clear()
            self._report_changed_list(kind, is_complete_list=True)
            self._send_ack_to_sender(link_id, message, MissionResult.ACCEPTED)
            return
        self._start_upload(link_id, message, kind, 0, message.count - 1)

    def handle_write_partial_list(self, link_id: int, message: Message) -> None:
        """MISSION_WRITE_PARTIAL_LIST: replace some items."""
        if not self._rules.accepts_partial_writes:
            return
        kind, first, last = message.mission_type, message.start_index, message.end_index
        if kind not in (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY):
            self._send_ack_to_sender(link_id, message, MissionResult.UNSUPPORTED)
            return
        items = self._store.items_of_type(kind)
        if self._upload is not None and not self._upload.is_from_peer(message):
            self._send_ack_to_sender(link_id, message, MissionResult.DENIED)
        elif not 0 <= first <= last or first > len(items) or last >= self._rules.capacity:
            self._send_ack_to_sender(link_id, message, MissionResult.ERROR)
        else:
            self._start_upload(link_id, message, kind, first, last)

    def handle_item_int(self, link_id: int, message: Message) -> None:
        """MISSION_ITEM_INT: the next item of an upload."""
        self._accept_upload_item(link_id, message, message.x, message.y)

    def handle_item_float(self, link_id: int, message: Message) -> None:
        """MISSION_ITEM: the same with degrees as floats."""
        scale = 1e7 if message.command in POSITIONED_COMMANDS else 1.0
        self._accept_upload_item(
            link_id,
            message,
            _coordinate_as_int32(message.x * scale),
            _coordinate_as_int32(message.y * scale),
        )

    def handle_request_list(self, link_id: int, message: Message) -> None:
        """MISSION_REQUEST_LIST: how many items there are."""
        kind = message.mission_type
        if kind not in (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY):
            self._send_ack_to_sender(link_id, message, MissionResult.UNSUPPORTED)
            return
        if self._refuse_while_receiving(link_id, message):
            return
        total = len(self._store.items_of_type(kind))
        now = self._state.t_s
        self._ended_upload = None
        self._download = Transfer(
            link_id,
            message.src_system,
            message.src_component,
            kind,
            first=0,
            last=total - 1,
            next_seq=0,
            last_received_s=now,
            last_request_s=now,
        )
        self._send_to_sender(link_id, message, "MISSION_COUNT", count=total, mission_type=kind)

    def handle_item_request(self, link_id: int, message: Message) -> None:
        """MISSION_REQUEST or MISSION_REQUEST_INT: one item to read back.

        ArduPilot gives any item at any time, PX4 in order within a download.
        """
        kind, seq = message.mission_type, message.seq
        if kind not in (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY):
            return
        if self._refuse_while_receiving(link_id, message):
            return
        items = self._store.items_of_type(kind)
        if self._rules.is_atomic and not self._advance_download_if_in_sequence(link_id, message):
            return
        if not 0 <= seq < len(items):
            self._send_ack_to_sender(link_id, message, MissionResult.INVALID_SEQUENCE)
            return
        self.send_stored_item(
            link_id, message.src_system, message.src_component, kind, seq, message.msg_name
        )

    def handle_clear_all(self, link_id: int, message: Message) -> None:
        """Handle MISSION_CLEAR_ALL; PX4 does not respond during a download."""
        if self._rules.is_atomic and self._download is not None:
            self._radio.send_status_text(Severity.CRITICAL, "WPM: IGN CLEAR CMD: Busy")
            return
        kind = message.mission_type
        kinds = (
            [MissionType.MISSION, MissionType.FENCE, MissionType.RALLY]
            if kind == MissionType.ALL
            else [kind]
        )
        if kind not in tuple(MissionType):
            self._send_ack_to_sender(link_id, message, MissionResult.UNSUPPORTED)
            return
        if MissionType.MISSION in kinds and not self._watcher.can_clear_mission():
            self._send_ack_to_sender(link_id, message, MissionResult.ERROR)
            return
        self._upload = None
        for each in kinds:
            self._store.items_of_type(each).clear()
            self._report_changed_list(each, is_complete_list=True)
        self._send_ack_to_sender(link_id, message, MissionResult.ACCEPTED)

    def handle_peer_ack(self, link_id: int, message: Message) -> None:
        """MISSION_ACK from a peer: a download is complete, or an upload cancelled."""
        download, upload = self._download, self._upload
        if download is not None and download.is_from_peer(message):
            self._download = None
        if (
            upload is not None
            and upload.is_from_peer(message)
            and message.type == MissionResult.OPERATION_CANCELLED
        ):
            self._upload = None

    # --- time ---------------------------------------------------------------------------------

    def retry_or_abort_stale_transfers(self) -> None:
        """Repeat the request for a missing item, and abort after the time-out."""
        upload = self._upload
        if upload is not None:
            now = self._state.t_s
            if now - upload.last_received_s > self._rules.timeout_s:
                self._upload, self._ended_upload = None, upload
                if self._rules.is_atomic:
                    self._radio.send_status_text(Severity.CRITICAL, "Operation timeout")
                else:
                    self._radio.send_status_text(Severity.WARNING, "Mission upload timeout")
                    self._send_ack(
                        upload.link_id,
                        upload.system,
                        upload.component,
                        MissionResult.OPERATION_CANCELLED,
                        upload.mission_type,
                    )
            elif now - upload.last_request_s > self._rules.retry_s:
                self._send_item_request(upload)
        download = self._download
        if (
            download is not None
            and self._state.t_s - download.last_received_s > self._rules.timeout_s
        ):
            self._download = None

    # --- parts --------------------------------------------------------------------------------

    def send_stored_item(
        self,
        link_id: int,
        target_system: int,
        target_component: int,
        mission_type: int,
        seq: int,
        request_name: str,
    ) -> None:
        """Send one stored item."""
        item = self._store.items_of_type(mission_type)[seq]
        if mission_type == MissionType.MISSION and seq == 0 and self._rules.has_home_item:
            item = _home_item(self._state)
        item = self._rules.encode_item(item)
        as_float = request_name == "MISSION_REQUEST"
        scale = 1e-7 if item.command in POSITIONED_COMMANDS else 1.0
        frame = item.frame
        if as_float and frame in (MavFrame.GLOBAL_INT, MavFrame.GLOBAL_RELATIVE_ALT_INT):
            frame = (
                MavFrame.GLOBAL if frame == MavFrame.GLOBAL_INT else MavFrame.GLOBAL_RELATIVE_ALT
            )
        self._radio.send(
            link_id,
            "MISSION_ITEM" if as_float else "MISSION_ITEM_INT",
            target_system=target_system,
            target_component=target_component,
            seq=seq,
            frame=int(frame),
            command=item.command,
            current=0,
            autocontinue=int(item.autocontinue),
            param1=item.param1,
            param2=item.param2,
            param3=item.param3,
            param4=item.param4,
            x=item.x * scale if as_float else item.x,
            y=item.y * scale if as_float else item.y,
            z=item.z,
            mission_type=mission_type,
        )

    def _start_upload(
        self, link_id: int, message: Message, mission_type: int, first_seq: int, last_seq: int
    ) -> None:
        now = self._state.t_s
        if mission_type == MissionType.MISSION:
            self._store.marked_current = None
        self._upload = Transfer(
            link_id,
            message.src_system,
            message.src_component,
            mission_type,
            first=first_seq,
            last=last_seq,
            next_seq=first_seq,
            last_received_s=now,
            last_request_s=now,
        )
        self._send_item_request(self._upload)

    def _send_item_request(self, upload: Transfer) -> None:
        upload.last_request_s = self._state.t_s
        self._radio.send(
            upload.link_id,
            self._rules.request_name,
            target_system=upload.system,
            target_component=upload.component,
            seq=upload.next_seq,
            mission_type=upload.mission_type,
        )

    def _accept_upload_item(self, link_id: int, message: Message, x: int, y: int) -> None:
        upload = self._upload
        kind = message.mission_type
        if upload is None or not upload.is_from_peer(message) or kind != upload.mission_type:
            ended = self._ended_upload if self._rules.is_atomic and upload is None else None
            is_repeated = ended is not None and ended.is_last_item(message)
            result = MissionResult.ACCEPTED if is_repeated else MissionResult.ERROR
            self._send_ack_to_sender(link_id, message, result)
            return
        if self._rules.is_atomic:
            upload.last_received_s = self._state.t_s
        if message.seq != upload.next_seq:
            if not self._rules.is_atomic:
                self._send_ack_to_sender(link_id, message, MissionResult.INVALID_SEQUENCE)
            return
        upload.last_received_s = self._state.t_s
        item = MissionItem(
            message.command,
            message.frame,
            message.param1,
            message.param2,
            message.param3,
            message.param4,
            x,
            y,
            message.z,
            bool(message.autocontinue),
        )
        is_home = self._rules.has_home_item and kind == MissionType.MISSION and message.seq == 0
        stored_item = _home_item(self._state) if is_home else self._rules.validate_item(item, kind)
        if isinstance(stored_item, MissionResult):
            self._upload = None
            self._send_ack_to_sender(link_id, message, stored_item)
            return
        if kind == MissionType.MISSION and message.current == 1:
            self._store.marked_current = message.seq
        self._store_or_buffer_item(upload, stored_item)
        upload.next_seq += 1
        if upload.next_seq <= upload.last:
            self._send_item_request(upload)
            return
        self._upload, self._ended_upload = None, upload
        if self._rules.is_atomic:
            self._store.items_of_type(kind)[:] = upload.items
        self._report_changed_list(kind, is_complete_list=True)
        self._send_ack_to_sender(link_id, message, MissionResult.ACCEPTED)

    def _refuse_while_receiving(self, link_id: int, message: Message) -> bool:
        """No download during an upload: PX4 does not respond, ArduPilot denies it."""
        if self._upload is not None and not self._rules.is_atomic:
            self._send_ack_to_sender(link_id, message, MissionResult.DENIED)
        return self._upload is not None

    def _store_or_buffer_item(self, upload: Transfer, item: MissionItem) -> None:
        """Store an item: in a buffer until the upload is complete, or directly."""
        if self._rules.is_atomic:
            upload.items.append(item)
            return
        items = self._store.items_of_type(upload.mission_type)
        if upload.next_seq < len(items):
            items[upload.next_seq] = item
        else:
            items.append(item)
        if upload.next_seq < upload.last:
            self._report_changed_list(upload.mission_type, is_complete_list=False)

    def _advance_download_if_in_sequence(self, link_id: int, message: Message) -> bool:
        """PX4: requests belong to a download and come in order, or again."""
        download = self._download
        if download is None or not download.is_from_peer(message):
            return False
        if message.mission_type != download.mission_type:
            return False
        download.last_received_s = self._state.t_s
        if message.seq == download.next_seq and message.seq <= download.last:
            download.next_seq += 1
            return True
        if message.seq == download.next_seq - 1:
            return True
        self._download = None
        self._send_ack_to_sender(link_id, message, MissionResult.ERROR)
        self._radio.send_status_text(Severity.CRITICAL, "WPM: REJ. CMD: Req. WP was unexpected")
        return False

    def _report_changed_list(self, mission_type: int, *, is_complete_list: bool) -> None:
        if mission_type == MissionType.MISSION:
            self._watcher.on_mission_changed(is_complete_list=is_complete_list)
        else:
            self._store.areas_revision += 1

    def _send_to_sender(self, link_id: int, message: Message, name: str, **fields: Any) -> None:
        self._radio.send(
            link_id,
            name,
            target_system=message.src_system,
            target_component=message.src_component,
            **fields,
        )

    def _send_ack_to_sender(self, link_id: int, message: Message, result: MissionResult) -> None:
        self._send_ack(
            link_id, message.src_system, message.src_component, result, message.mission_type
        )

    def _send_ack(
        self,
        link_id: int,
        target_system: int,
        target_component: int,
        result: MissionResult,
        mission_type: int,
    ) -> None:
        self._radio.send(
            link_id,
            "MISSION_ACK",
            target_system=target_system,
            target_component=target_component,
            type=int(result),
            mission_type=mission_type,
        )


def _home_item(state: VehicleState) -> MissionItem:
    """The home position as a mission item (ArduPilot's item 0)."""
    if not state.home_is_set:
        return MissionItem(Cmd.NAV_WAYPOINT, MavFrame.GLOBAL)
    north, east, down = state.home_ned_m
    lat, lon = state.frame.to_lat_lon_deg(north, east)
    z = round((state.frame.alt_amsl_m - down) * 100.0) / 100.0
    return MissionItem(
        Cmd.NAV_WAYPOINT, MavFrame.GLOBAL, x=round(lat * 1e7), y=round(lon * 1e7), z=z
    )


def _coordinate_as_int32(value: float) -> int:
    """A float as a MISSION_ITEM_INT would carry it; not a number is no coordinate."""
    if not math.isfinite(value) or abs(value) >= NO_COORDINATE:
        return NO_COORDINATE
    return round(value)
