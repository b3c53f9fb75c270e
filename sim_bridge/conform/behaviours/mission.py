"""Missions on the ground: upload, read-back, counting, clearing, partial writes."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import Behaviours, Observation
from sim_bridge.conform.client import NO_RESPONSE, Message
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.missions import Item, Uploaded
from sim_bridge.conform.subject import Subject, observed_once

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

WAYPOINT = mavlink.MAV_CMD_NAV_WAYPOINT
LOITER_TIME = mavlink.MAV_CMD_NAV_LOITER_TIME
LAND = mavlink.MAV_CMD_NAV_LAND
TAKEOFF = mavlink.MAV_CMD_NAV_TAKEOFF
_RADIUS_M = 7.0
_SPEED_MPS = 3.0
_FENCE_VERTEX = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
_FENCE, _RALLY = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY
_TERRAIN = mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT


def _storage_test_items(subject: Subject) -> list[Item]:
    """Items whose fields show how storage changes them."""
    amsl_m = subject.home_amsl_m + 20.0
    return [
        subject.item(TAKEOFF, 0.0, 0.0, 20.0, param4=math.nan),
        subject.item(WAYPOINT, 50.0, 0.0, 20.0, param2=_RADIUS_M, param4=math.nan),
        subject.item(WAYPOINT, 60.0, 0.0, amsl_m, frame=0),
        Item(mavlink.MAV_CMD_DO_CHANGE_SPEED, param1=1.0, param2=_SPEED_MPS, frame=2),
        subject.item(LOITER_TIME, 60.0, 30.0, 20.0, param1=4.0),
        subject.item(LAND, 60.0, 30.0),
    ]


def _upload_test_items(subject: Subject) -> Uploaded:
    return subject.upload(_storage_test_items(subject))


def _download(subject: Subject, minimum_count: int = 0) -> list[Message]:
    stored = missions.download(subject.client)
    if stored is None or len(stored) < minimum_count:
        raise ObservationError("no read-back")
    return stored


@observed_once
def _upload_and_read_back(subject: Subject) -> tuple[Uploaded, list[Message]]:
    return _upload_test_items(subject), _download(subject)


def _stored_item(subject: Subject, item_index: int) -> Message:
    stored = _upload_and_read_back(subject)[1]
    seq = item_index + subject.first_flown_seq()
    if seq >= len(stored):
        raise ObservationError(f"only {len(stored)} items are stored")
    return stored[seq]


@behaviour("mission/asked_with", "Items of an upload are requested with")
def _observed_request_message_names(subject: Subject) -> str:
    names = _upload_and_read_back(subject)[0].request_messages
    return " and ".join(sorted(names)) or "nothing"


BEHAVIOURS.add("mission/accepted", "A whole upload is", lambda s: _upload_and_read_back(s)[0].ack)


@behaviour("mission/count", "Items counted in addition to the flown items")
def _count_stored_items_beyond_sent(subject: Subject) -> int:
    """Stored items more than the real ones sent."""
    return len(_upload_and_read_back(subject)[1]) - len(_storage_test_items(subject))


@behaviour("mission/item_0", "Item 0, a waypoint elsewhere, is")
def _observe_item_0_storage(subject: Subject) -> Observation:
    """Item 0 is sent as a waypoint 50 m from home."""
    sent = [subject.item(WAYPOINT, 50.0, 0.0, 20.0), subject.item(WAYPOINT, 60.0, 0.0, 20.0)]
    done = missions.upload(subject.client, sent)
    stored = _download(subject, minimum_count=1)
    off_m = abs(stored[0].x * 1e-7 - sent[0].lat_deg) * 111_000.0
    word = "kept" if off_m < 1.0 else "replaced by home"
    return Observation(f"{word}, {done.ack}", f"{off_m:.0f} m from what was sent")


@behaviour("mission/nan", "A waypoint's NaN yaw reads back as")
def _read_back_nan_yaw(subject: Subject) -> str:
    value = _stored_item(subject, 1).param4
    return "NaN" if math.isnan(value) else f"{value:g}"


@behaviour("mission/radius", f"A waypoint's radius of {_RADIUS_M:g} reads back as")
def _read_back_waypoint_radius(subject: Subject) -> str:
    return f"{_stored_item(subject, 1).param2:g}"


@behaviour("mission/change_speed", "A DO_CHANGE_SPEED item is")
def _observe_change_speed_item_storage(subject: Subject) -> Observation:
    item = _stored_item(subject, 3)
    kept = item.param1 == 1.0 and item.param2 == _SPEED_MPS
    return Observation("kept" if kept else "changed", f"{item.param1:g}, {item.param2:g}")


@behaviour("mission/old_request", "MISSION_REQUEST is answered with")
def _response_type_to_mission_request(subject: Subject) -> str:
    """Return the response to MISSION_REQUEST, the older request."""
    _upload_test_items(subject)
    missions.start_download_and_count(subject.client)
    subject.client.send("MISSION_REQUEST", seq=0, mission_type=0)
    reply = subject.client.wait_next_message(("MISSION_ITEM", "MISSION_ITEM_INT"), 3.0)
    missions.send_download_ack(subject.client)
    return NO_RESPONSE if reply is None else reply.get_type()


@behaviour("mission/total", "MISSION_CURRENT.total beyond the items sent")
def _mission_current_total_beyond_sent(subject: Subject) -> int:
    """MISSION_CURRENT.total less the real items sent."""
    _upload_test_items(subject)
    return _next_mission_current(subject).total - len(_storage_test_items(subject))


def _next_mission_current(subject: Subject) -> Message:
    """Return a MISSION_CURRENT that is sent after the request before took effect."""
    subject.client.collect_messages(1.2)
    message = subject.client.wait_next_message("MISSION_CURRENT", 3.0)
    if message is None:
        raise ObservationError("no MISSION_CURRENT comes")
    return message


@behaviour("mission/total_empty", "MISSION_CURRENT.total without a mission")
def _mission_current_total_when_empty(subject: Subject) -> int:
    missions.clear_stored_list(subject.client)
    return _next_mission_current(subject).total


@behaviour("mission/partial", "A partial write on the ground is")
def _observe_partial_write(subject: Subject) -> str:
    """Replace one waypoint, and read it back."""
    _upload_test_items(subject)
    seq, item = subject.first_flown_seq() + 1, subject.item(WAYPOINT, 80.0, 0.0, 20.0)
    done = missions.write_partial(subject.client, seq, [item])
    stored = _download(subject, minimum_count=seq + 1)
    is_stored = abs(stored[seq].x * 1e-7 - item.lat_deg) < 1e-6
    return f"{done.ack}, {'written' if is_stored else 'not written'}"


@behaviour("mission/clear", "Clearing on the ground is")
def _observe_mission_clear(subject: Subject) -> str:
    _upload_test_items(subject)
    response = missions.clear_stored_list(subject.client)
    return f"{response}, {missions.request_count(subject.client)} stored"


@behaviour("mission/out_of_order", "A request for an item out of sequence gives")
def _response_to_out_of_order_request(subject: Subject) -> str:
    """Request an item without requesting the list first, out of sequence."""
    _upload_test_items(subject)
    subject.client.send("MISSION_REQUEST_INT", seq=3, mission_type=0)
    reply = subject.client.wait_next_message(("MISSION_ITEM_INT", "MISSION_ACK"), 2.5)
    return NO_RESPONSE if reply is None else reply.get_type()


@behaviour("mission/unfinished_download", "An upload during a download is")
def _upload_during_download(subject: Subject) -> str:
    """Upload during a download that is not yet acknowledged."""
    _upload_test_items(subject)
    missions.start_download_and_count(subject.client)
    done = _upload_test_items(subject)
    subject.client.collect_messages(8.0)
    missions.send_download_ack(subject.client)
    return done.ack


def count_stored_and_southern(subject: Subject) -> tuple[int, int]:
    """Return the number of stored items, and of waypoints over 40 m south of home."""
    stored, limit_deg = _download(subject), subject.lat_lon_deg_from_home(-40.0, 0.0)[0]
    return len(stored), sum(m.command == WAYPOINT and m.x * 1e-7 < limit_deg for m in stored)


@behaviour("mission/cut_on_ground", "After an interrupted upload the stored mission is")
def _observe_interrupted_upload(subject: Subject) -> Observation:
    """Return the stored mission after an upload of other items that stops after the second."""
    _upload_test_items(subject)
    other = [subject.item(WAYPOINT, -50.0, 10.0 * n, 20.0) for n in range(4)]
    broken = subject.upload(other, max_items=2)
    late = subject.client.wait_next_message("MISSION_ACK", 15.0)
    count, south = count_stored_and_southern(subject)
    is_whole = count == len(subject.with_home_item(_storage_test_items(subject))) and south == 0
    word = "the old mission whole" if is_whole else "a mixture" if south else "something else"
    report_state = "told" if late is not None else "not told"
    note = f"{count} stored, {south} new, asked {len(broken.requested_seqs)} times"
    return Observation(f"{word}, {report_state}", note)


@behaviour("mission/empty_upload", "An upload of 0 items is")
def _observe_empty_upload(subject: Subject) -> str:
    _upload_test_items(subject)
    subject.client.send("MISSION_COUNT", count=0, mission_type=0)
    ack = subject.client.wait_next_message("MISSION_ACK", 3.0)
    left = missions.request_count(subject.client)
    return f"{NO_RESPONSE if ack is None else 'answered'}, {left} stored"


def _upload_count_and_clear(subject: Subject, items: list[Item], mission_type: int) -> str:
    done = missions.upload(subject.client, items, mission_type)
    stored = missions.request_count(subject.client, mission_type)
    cleared = missions.clear_stored_list(subject.client, mission_type)
    return f"{done.ack}, {stored} stored, clearing {cleared}"


@behaviour("fence/upload", "A fence polygon is")
def _observe_fence_upload_and_clear(subject: Subject) -> str:
    corners = ((80.0, 80.0), (80.0, -80.0), (-80.0, -80.0), (-80.0, 80.0))
    items = [subject.item(_FENCE_VERTEX, n, e, frame=0, param1=4.0) for n, e in corners]
    return _upload_count_and_clear(subject, items, _FENCE)


@behaviour("fence/rally", "A rally point is")
def _observe_rally_upload_and_clear(subject: Subject) -> str:
    point = subject.item(mavlink.MAV_CMD_NAV_RALLY_POINT, 30.0, 0.0, 20.0, frame=3)
    return _upload_count_and_clear(subject, [point], _RALLY)


@behaviour("fence/wrong_item", "A waypoint uploaded as a fence is")
def _upload_waypoint_as_fence(subject: Subject) -> str:
    item = subject.item(WAYPOINT, 10.0, 0.0, 20.0)
    return missions.upload(subject.client, [item], _FENCE).ack


@behaviour("mission/terrain", "A mission in the terrain frame, then arming, is")
def _observe_terrain_mission_and_arming(subject: Subject) -> str:
    """Upload terrain-frame items, then request arming."""
    takeoff = subject.item(TAKEOFF, 0.0, 0.0, 20.0)
    done = subject.upload([takeoff, subject.item(WAYPOINT, 50.0, 0.0, 20.0, frame=_TERRAIN)])
    subject.client.collect_messages(3.0)
    response = subject.request_arm()
    subject.client.collect_messages(0.5)
    subject.request_disarm()
    return f"{done.ack}, arming {response}"


def _upload_and_select_third_item(subject: Subject) -> int:
    _upload_test_items(subject)
    subject.client.collect_messages(3.0)
    return subject.first_flown_seq() + 2


@behaviour("mission/jump_on_ground", "DO_SET_MISSION_CURRENT, disarmed, is")
def _observe_jump_command_on_ground(subject: Subject) -> str:
    """DO_SET_MISSION_CURRENT while disarmed, and MISSION_CURRENT after it."""
    seq = _upload_and_select_third_item(subject)
    response = subject.client.send_command_and_wait_ack(
        mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, float(seq)
    )
    return f"{response}, {'there' if _next_mission_current(subject).seq == seq else 'not there'}"


@behaviour("mission/set_current_on_ground", "MISSION_SET_CURRENT, disarmed, is")
def _observe_set_current_on_ground(subject: Subject) -> str:
    seq = _upload_and_select_third_item(subject)
    subject.client.send("MISSION_SET_CURRENT", seq=seq)
    return "there" if _next_mission_current(subject).seq == seq else "not there"


@behaviour("mission/set_current_wrong", "MISSION_SET_CURRENT beyond the list is")
def _observe_set_current_beyond_list(subject: Subject) -> str:
    """A number that is not in the list."""
    _upload_test_items(subject)
    before = _next_mission_current(subject).seq
    subject.client.send("MISSION_SET_CURRENT", seq=77)
    after = _next_mission_current(subject).seq
    return "ignored" if after == before else f"now at {after}"


for _name, _description, _index in (
    ("mission/frame_6", "An item in frame 6 reads back in frame", 1),
    ("mission/frame_0", "An item in frame 0 reads back in frame", 2),
    ("mission/frame_2", "A DO item in frame 2 reads back in frame", 3),
):
    BEHAVIOURS.add(_name, _description, lambda s, i=_index: f"{_stored_item(s, i).frame}")
