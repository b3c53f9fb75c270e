"""The mission protocol's server side: uploads, downloads, partial writes, clearing.

What each autopilot does differently is in its `MissionRules`; it is told of changes through
`MissionWatcher`. Sources: mavlink.io/en/services/mission.html; ArduPilot,
libraries/GCS_MAVLink/MissionItemProtocol.cpp; PX4, src/modules/mavlink/mavlink_mission.cpp.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Protocol

from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, MavFrame, MissionResult, MissionType, Severity
from sim_bridge.autopilot.mission.items import NO_COORDINATE, PLACED, MissionItem, MissionStore
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState


class MissionRules(Protocol):
    """How an autopilot takes part in the mission protocol."""

    @property
    def request_name(self) -> str:
        """Name of the message by which an upload asks for the next item."""
        ...

    @property
    def unknown_type(self) -> MissionResult:
        """The answer to an upload of a type that there is not."""
        ...

    @property
    def has_home_item(self) -> bool:
        """Whether index 0 of a mission is the home position, whatever was uploaded there."""
        ...

    @property
    def is_atomic(self) -> bool:
        """Whether an upload takes effect as a whole, after its last item."""
        ...

    @property
    def takes_partial_writes(self) -> bool:
        """Whether MISSION_WRITE_PARTIAL_LIST is answered."""
        ...

    @property
    def retry_s(self) -> float:
        """Seconds after which an item is asked for again."""
        ...

    @property
    def timeout_s(self) -> float:
        """Seconds of silence after which a transfer is given up."""
        ...

    @property
    def capacity(self) -> int:
        """Items that storage holds."""
        ...

    def take(self, item: MissionItem, mission_type: int) -> MissionItem | MissionResult:
        """The item as it is stored, or why it is refused."""
        ...

    def give(self, item: MissionItem) -> MissionItem:
        """The item as it is read back in a MISSION_ITEM_INT."""
        ...


class MissionWatcher(Protocol):
    """The autopilot whose missions these are."""

    def may_clear_mission(self) -> bool:
        """Whether a mission may be cleared now."""
        ...

    def mission_written(self, *, whole: bool) -> None:
        """The mission has changed; `whole` when a complete upload or clearing has taken effect."""
        ...


@dataclass(slots=True)
class _Transfer:
    """An upload or download under way with one partner."""

    link_id: int
    system: int
    component: int
    mission_type: int
    first: int
    last: int
    next_seq: int
    heard_s: float
    asked_s: float
    items: list[MissionItem] = field(default_factory=list)


class MissionProtocol:
    """One mission protocol server; all the vehicle's links share it."""

    def __init__(
        self,
        state: VehicleState,
        radio: Radio,
        watcher: MissionWatcher,
        rules: MissionRules,
        store: MissionStore,
    ) -> None:
        self._state = state
        self._radio = radio
        self._watcher = watcher
        self._rules = rules
        self._store = store
        self._upload: _Transfer | None = None
        self._download: _Transfer | None = None

    def reset(self) -> None:
        """Forget transfers under way, as a reboot does."""
        self._upload = None
        self._download = None

    # --- messages -----------------------------------------------------------------------------

    def count(self, link_id: int, message: Message) -> None:
        """MISSION_COUNT: an upload begins, or with 0 items is over."""
        rules = self._rules
        kind = message.mission_type
        if kind not in (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY):
            self._ack(link_id, message, rules.unknown_type)
            return
        if rules.is_atomic and self._download is not None:  # PX4: one transfer at a time
            self._ack(link_id, message, MissionResult.ERROR)
            return
        upload = self._upload
        if upload is not None and not (
            _same_partner(upload, message) and (not rules.is_atomic or upload.next_seq == 0)
        ):
            self._ack(link_id, message, MissionResult.ERROR)
            return
        if message.count > rules.capacity:
            self._ack(link_id, message, MissionResult.NO_SPACE)
            return
        if not rules.is_atomic:
            del self._store.of(kind)[message.count :]
        if message.count == 0:
            self._upload = None
            self._store.of(kind).clear()
            self._written(kind, whole=True)
            self._ack(link_id, message, MissionResult.ACCEPTED)
            return
        self._begin(link_id, message, kind, 0, message.count - 1)

    def write_partial_list(self, link_id: int, message: Message) -> None:
        """MISSION_WRITE_PARTIAL_LIST: replace some items."""
        if not self._rules.takes_partial_writes:
            return
        kind, first, last = message.mission_type, message.start_index, message.end_index
        if kind not in (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY):
            self._ack(link_id, message, MissionResult.UNSUPPORTED)
            return
        items = self._store.of(kind)
        if self._upload is not None and not _same_partner(self._upload, message):
            self._ack(link_id, message, MissionResult.DENIED)
        elif not 0 <= first <= last or first > len(items) or last >= self._rules.capacity:
            self._ack(link_id, message, MissionResult.ERROR)
        else:
            self._begin(link_id, message, kind, first, last)

    def item_int(self, link_id: int, message: Message) -> None:
        """MISSION_ITEM_INT: the next item of an upload."""
        self._item(link_id, message, message.x, message.y)

    def item_float(self, link_id: int, message: Message) -> None:
        """MISSION_ITEM: the same with degrees as floats."""
        scale = 1e7 if message.command in PLACED else 1.0
        self._item(link_id, message, _as_int32(message.x * scale), _as_int32(message.y * scale))

    def request_list(self, link_id: int, message: Message) -> None:
        """MISSION_REQUEST_LIST: how many items there are."""
        kind = message.mission_type
        if kind not in (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY):
            self._ack(link_id, message, MissionResult.UNSUPPORTED)
            return
        total = len(self._store.of(kind))
        now = self._state.t_s
        self._download = _Transfer(
            link_id,
            message.src_system,
            message.src_component,
            kind,
            first=0,
            last=total - 1,
            next_seq=0,
            heard_s=now,
            asked_s=now,
        )
        self._reply(link_id, message, "MISSION_COUNT", count=total, mission_type=kind)

    def request(self, link_id: int, message: Message) -> None:
        """MISSION_REQUEST or MISSION_REQUEST_INT: one item to read back.

        ArduPilot gives any item at any time, PX4 in order within a download.
        """
        kind, seq = message.mission_type, message.seq
        if kind not in (MissionType.MISSION, MissionType.FENCE, MissionType.RALLY):
            return
        items = self._store.of(kind)
        if self._rules.is_atomic and not self._in_order(link_id, message):
            return
        if not 0 <= seq < len(items):
            self._ack(link_id, message, MissionResult.INVALID_SEQUENCE)
            return
        self.give_item(
            link_id, message.src_system, message.src_component, kind, seq, message.msg_name
        )

    def clear_all(self, link_id: int, message: Message) -> None:
        """MISSION_CLEAR_ALL; PX4 does not answer amid a download."""
        if self._rules.is_atomic and self._download is not None:
            self._radio.say(Severity.CRITICAL, "WPM: IGN CLEAR CMD: Busy")
            return
        kind = message.mission_type
        kinds = (
            [MissionType.MISSION, MissionType.FENCE, MissionType.RALLY]
            if kind == MissionType.ALL
            else [kind]
        )
        if kind not in tuple(MissionType):
            self._ack(link_id, message, MissionResult.UNSUPPORTED)
            return
        if MissionType.MISSION in kinds and not self._watcher.may_clear_mission():
            self._ack(link_id, message, MissionResult.ERROR)
            return
        self._upload = None
        for each in kinds:
            self._store.of(each).clear()
            self._written(each, whole=True)
        self._ack(link_id, message, MissionResult.ACCEPTED)

    def ack(self, link_id: int, message: Message) -> None:
        """MISSION_ACK from a partner: a download is done, or an upload called off."""
        download, upload = self._download, self._upload
        if download is not None and _same_partner(download, message):
            self._download = None
        if (
            upload is not None
            and _same_partner(upload, message)
            and message.type == MissionResult.OPERATION_CANCELLED
        ):
            self._upload = None

    # --- time ---------------------------------------------------------------------------------

    def step(self) -> None:
        """Ask again for what did not come, and give up after the time-out."""
        upload = self._upload
        if upload is not None:
            now = self._state.t_s
            if now - upload.heard_s > self._rules.timeout_s:
                self._upload = None
                if self._rules.is_atomic:
                    self._radio.say(Severity.CRITICAL, "Operation timeout")
                else:
                    self._radio.say(Severity.WARNING, "Mission upload timeout")
                    self._send_ack(
                        upload.link_id,
                        upload.system,
                        upload.component,
                        MissionResult.OPERATION_CANCELLED,
                        upload.mission_type,
                    )
            elif now - upload.asked_s > self._rules.retry_s:
                self._ask(upload)
        download = self._download
        if download is not None and self._state.t_s - download.heard_s > self._rules.timeout_s:
            self._download = None

    # --- parts --------------------------------------------------------------------------------

    def give_item(
        self, link_id: int, system: int, component: int, kind: int, seq: int, asked_by: str
    ) -> None:
        """Send one stored item."""
        item = self._store.of(kind)[seq]
        if kind == MissionType.MISSION and seq == 0 and self._rules.has_home_item:
            item = self._home_item()
        item = self._rules.give(item)
        as_float = asked_by == "MISSION_REQUEST"
        scale = 1e-7 if item.command in PLACED else 1.0
        frame = item.frame
        if as_float and frame in (MavFrame.GLOBAL_INT, MavFrame.GLOBAL_RELATIVE_ALT_INT):
            frame = (
                MavFrame.GLOBAL if frame == MavFrame.GLOBAL_INT else MavFrame.GLOBAL_RELATIVE_ALT
            )
        self._radio.send(
            link_id,
            "MISSION_ITEM" if as_float else "MISSION_ITEM_INT",
            target_system=system,
            target_component=component,
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
            mission_type=kind,
        )

    def _begin(self, link_id: int, message: Message, kind: int, first: int, last: int) -> None:
        now = self._state.t_s
        if kind == MissionType.MISSION:
            self._store.marked_current = None
        self._upload = _Transfer(
            link_id,
            message.src_system,
            message.src_component,
            kind,
            first=first,
            last=last,
            next_seq=first,
            heard_s=now,
            asked_s=now,
        )
        self._ask(self._upload)

    def _ask(self, upload: _Transfer) -> None:
        upload.asked_s = self._state.t_s
        self._radio.send(
            upload.link_id,
            self._rules.request_name,
            target_system=upload.system,
            target_component=upload.component,
            seq=upload.next_seq,
            mission_type=upload.mission_type,
        )

    def _item(self, link_id: int, message: Message, x: int, y: int) -> None:
        upload = self._upload
        kind = message.mission_type
        if upload is None or not _same_partner(upload, message) or kind != upload.mission_type:
            self._ack(link_id, message, MissionResult.ERROR)
            return
        if message.seq != upload.next_seq:
            if not self._rules.is_atomic:
                self._ack(link_id, message, MissionResult.INVALID_SEQUENCE)
            return
        upload.heard_s = self._state.t_s
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
        taken = self._home_item() if is_home else self._rules.take(item, kind)
        if isinstance(taken, MissionResult):
            self._upload = None
            self._ack(link_id, message, taken)
            return
        if kind == MissionType.MISSION and message.current == 1:
            self._store.marked_current = message.seq
        self._keep(upload, taken)
        upload.next_seq += 1
        if upload.next_seq <= upload.last:
            self._ask(upload)
            return
        self._upload = None
        if self._rules.is_atomic:
            self._store.of(kind)[:] = upload.items
        self._written(kind, whole=True)
        self._ack(link_id, message, MissionResult.ACCEPTED)

    def _keep(self, upload: _Transfer, item: MissionItem) -> None:
        """Put an item where it belongs: aside until all are there, or straight into storage."""
        if self._rules.is_atomic:
            upload.items.append(item)
            return
        items = self._store.of(upload.mission_type)
        if upload.next_seq < len(items):
            items[upload.next_seq] = item
        else:
            items.append(item)
        if upload.next_seq < upload.last:
            self._written(upload.mission_type, whole=False)

    def _in_order(self, link_id: int, message: Message) -> bool:
        """PX4: requests belong to a download and come in order, or again."""
        download = self._download
        if download is None or not _same_partner(download, message):
            return False
        if message.mission_type != download.mission_type:
            return False
        download.heard_s = self._state.t_s
        if message.seq == download.next_seq and message.seq <= download.last:
            download.next_seq += 1
            return True
        if message.seq == download.next_seq - 1:
            return True
        self._download = None
        self._ack(link_id, message, MissionResult.ERROR)
        self._radio.say(Severity.CRITICAL, "WPM: REJ. CMD: Req. WP was unexpected")
        return False

    def _written(self, kind: int, *, whole: bool) -> None:
        if kind == MissionType.MISSION:
            self._watcher.mission_written(whole=whole)
        else:
            self._store.areas_revision += 1

    def _home_item(self) -> MissionItem:
        """The home position as a mission item (ArduPilot's item 0)."""
        state = self._state
        if not state.home_is_set:
            return MissionItem(Cmd.NAV_WAYPOINT, MavFrame.GLOBAL)
        north, east, down = state.home_ned_m
        lat, lon = state.frame.to_lat_lon_deg(north, east)
        z = round((state.frame.alt_amsl_m - down) * 100.0) / 100.0
        return MissionItem(
            Cmd.NAV_WAYPOINT, MavFrame.GLOBAL, x=round(lat * 1e7), y=round(lon * 1e7), z=z
        )

    def _reply(self, link_id: int, message: Message, name: str, **fields: Any) -> None:
        self._radio.send(
            link_id,
            name,
            target_system=message.src_system,
            target_component=message.src_component,
            **fields,
        )

    def _ack(self, link_id: int, message: Message, result: MissionResult) -> None:
        self._send_ack(
            link_id, message.src_system, message.src_component, result, message.mission_type
        )

    def _send_ack(
        self, link_id: int, system: int, component: int, result: MissionResult, kind: int
    ) -> None:
        self._radio.send(
            link_id,
            "MISSION_ACK",
            target_system=system,
            target_component=component,
            type=int(result),
            mission_type=kind,
        )


def _same_partner(transfer: _Transfer, message: Message) -> bool:
    return (transfer.system, transfer.component) == (message.src_system, message.src_component)


def _as_int32(value: float) -> int:
    """A float as a MISSION_ITEM_INT would carry it; not a number is no coordinate."""
    if not math.isfinite(value) or abs(value) >= NO_COORDINATE:
        return NO_COORDINATE
    return round(value)
