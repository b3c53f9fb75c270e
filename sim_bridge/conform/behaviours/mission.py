"""Missions on the ground: upload, read-back, counting, clearing, partial writes."""

import math
from typing import cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import Behaviour, Finding
from sim_bridge.conform.client import Message
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.missions import Item, Uploaded
from sim_bridge.conform.subject import Subject

WAYPOINT = mavlink.MAV_CMD_NAV_WAYPOINT
LOITER_TIME = mavlink.MAV_CMD_NAV_LOITER_TIME
LAND = mavlink.MAV_CMD_NAV_LAND
TAKEOFF = mavlink.MAV_CMD_NAV_TAKEOFF
_RADIUS_M = 7.0
_SPEED_MPS = 3.0
_FENCE_VERTEX = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
_FENCE, _RALLY = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY


def waypoint(s: Subject, north_m: float, east_m: float, up_m: float = 20.0) -> Item:
    """A waypoint relative to home."""
    return Item(WAYPOINT, *s.place(north_m, east_m), up_m)


def _probe(s: Subject) -> list[Item]:
    """Items whose fields tell what storage does to them."""
    return [
        Item(TAKEOFF, *s.place(0.0, 0.0), 20.0, param4=math.nan),
        Item(WAYPOINT, *s.place(50.0, 0.0), 20.0, param2=_RADIUS_M, param4=math.nan),
        Item(WAYPOINT, *s.place(60.0, 0.0), s.home_amsl_m + 20.0, frame=0),
        Item(mavlink.MAV_CMD_DO_CHANGE_SPEED, param1=1.0, param2=_SPEED_MPS, frame=2),
        Item(LOITER_TIME, *s.place(60.0, 30.0), 20.0, param1=4.0),
        Item(LAND, *s.place(60.0, 30.0), 0.0),
    ]


def _uploaded(s: Subject) -> tuple[Uploaded, list[Message]]:
    """One upload and its read-back, from whose items the behaviours are read."""

    def look() -> tuple[Uploaded, list[Message]]:
        done = s.upload(_probe(s))
        stored = missions.download(s.client)
        if stored is None:
            raise CannotSee(f"no read-back after an upload that ended with {done.ack}")
        return done, stored

    return cast(tuple[Uploaded, list[Message]], s.remember("mission read-back", look))


def _stored(s: Subject, index: int) -> Message:
    stored = _uploaded(s)[1]
    seq = index + s.first_seq()
    if seq >= len(stored):
        raise CannotSee(f"only {len(stored)} items are stored")
    return stored[seq]


def _asked_with(s: Subject) -> str:
    return " and ".join(sorted(_uploaded(s)[0].asked_with)) or "nothing"


def _answered(s: Subject) -> str:
    return _uploaded(s)[0].ack


def _count(s: Subject) -> int:
    """Stored items more than the real ones sent."""
    return len(_uploaded(s)[1]) - len(_probe(s))


def _first_item(s: Subject) -> Finding:
    """Item 0 is sent as a waypoint 50 m from home."""
    sent = [waypoint(s, 50.0, 0.0), waypoint(s, 60.0, 0.0)]
    done = missions.upload(s.client, sent)
    stored = missions.download(s.client)
    if not stored:
        raise CannotSee("no read-back")
    off_m = abs(stored[0].x * 1e-7 - sent[0].lat_deg) * 111_000.0
    word = "kept" if off_m < 1.0 else "replaced by home"
    return Finding(f"{word}, {done.ack}", f"{off_m:.0f} m from what was sent")


def _frame(index: int):
    def see(s: Subject) -> str:
        return f"{_stored(s, index).frame}"

    return see


def _nan(s: Subject) -> str:
    value = _stored(s, 1).param4
    return "NaN" if math.isnan(value) else f"{value:g}"


def _radius(s: Subject) -> str:
    return f"{_stored(s, 1).param2:g}"


def _change_speed(s: Subject) -> Finding:
    item = _stored(s, 3)
    kept = item.param1 == 1.0 and item.param2 == _SPEED_MPS
    return Finding("kept" if kept else "changed", f"{item.param1:g}, {item.param2:g}")


def _item_message(s: Subject) -> str:
    """What MISSION_REQUEST, the older request, is answered with."""
    s.upload(_probe(s))
    missions.begin_download(s.client)
    s.client.send("MISSION_REQUEST", seq=0, mission_type=0)
    reply = s.client.hear(("MISSION_ITEM", "MISSION_ITEM_INT"), 3.0)
    missions.end_download(s.client)
    return "no answer" if reply is None else reply.get_type()


def _total(s: Subject) -> int:
    """MISSION_CURRENT.total less the real items sent."""
    s.upload(_probe(s))
    s.client.collect(1.2)
    return _current(s).total - len(_probe(s))


def _current(s: Subject) -> Message:
    message = s.client.hear("MISSION_CURRENT", 3.0)
    if message is None:
        raise CannotSee("no MISSION_CURRENT comes")
    return message


def _total_empty(s: Subject) -> int:
    missions.clear(s.client)
    s.client.collect(1.2)
    return _current(s).total


def _partial(s: Subject) -> str:
    """Replace one waypoint, and read it back."""
    s.upload(_probe(s))
    seq = s.first_seq() + 1
    done = missions.write_partial(s.client, seq, [waypoint(s, 80.0, 0.0)])
    stored = missions.download(s.client)
    if not stored or len(stored) <= seq:
        raise CannotSee("no read-back")
    written = abs(stored[seq].x * 1e-7 - s.place(80.0, 0.0)[0]) < 1e-6
    return f"{done.ack}, {'written' if written else 'not written'}"


def _clear(s: Subject) -> str:
    s.upload(_probe(s))
    answer = missions.clear(s.client)
    return f"{answer}, {missions.count(s.client)} stored"


def _out_of_order(s: Subject) -> str:
    """An item asked for without asking for the list, and not the next one."""
    s.upload(_probe(s))
    s.client.send("MISSION_REQUEST_INT", seq=3, mission_type=0)
    reply = s.client.hear(("MISSION_ITEM_INT", "MISSION_ACK"), 2.5)
    return "no answer" if reply is None else reply.get_type()


def _unfinished_download(s: Subject) -> str:
    """An upload while a download has been begun and is not acknowledged."""
    s.upload(_probe(s))
    missions.begin_download(s.client)
    done = s.upload(_probe(s))
    s.client.collect(8.0)
    missions.end_download(s.client)
    return done.ack


def _cut_on_ground(s: Subject) -> Finding:
    """What is stored after an upload of other items that stops after the second."""
    s.upload(_probe(s))
    other = s.with_home([waypoint(s, -50.0, 10.0 * n) for n in range(4)])
    broken = missions.upload(s.client, other, only=2)
    late = s.client.hear("MISSION_ACK", 15.0)
    stored = missions.download(s.client)
    if stored is None:
        raise CannotSee("no read-back")
    south = sum(m.x * 1e-7 < s.place(-40.0, 0.0)[0] for m in stored if m.command == WAYPOINT)
    whole = len(stored) == len(s.with_home(_probe(s))) and south == 0
    word = "the old mission whole" if whole else "a mixture" if south else "something else"
    told = "told" if late is not None else "not told"
    note = f"{len(stored)} stored, {south} new, asked {len(broken.asked_for)} times"
    return Finding(f"{word}, {told}", note)


def _empty_upload(s: Subject) -> str:
    s.upload(_probe(s))
    s.client.send("MISSION_COUNT", count=0, mission_type=0)
    ack = s.client.hear("MISSION_ACK", 3.0)
    left = missions.count(s.client)
    return f"{'no answer' if ack is None else 'answered'}, {left} stored"


def _fence(s: Subject) -> str:
    corners = ((80.0, 80.0), (80.0, -80.0), (-80.0, -80.0), (-80.0, 80.0))
    items = [Item(_FENCE_VERTEX, *s.place(n, e), 0.0, frame=0, param1=4.0) for n, e in corners]
    done = missions.upload(s.client, items, _FENCE)
    stored = missions.count(s.client, _FENCE)
    cleared = missions.clear(s.client, _FENCE)
    return f"{done.ack}, {stored} stored, clearing {cleared}"


def _rally(s: Subject) -> str:
    items = [Item(mavlink.MAV_CMD_NAV_RALLY_POINT, *s.place(30.0, 0.0), 20.0, frame=3)]
    done = missions.upload(s.client, items, _RALLY)
    stored = missions.count(s.client, _RALLY)
    cleared = missions.clear(s.client, _RALLY)
    return f"{done.ack}, {stored} stored, clearing {cleared}"


def _fence_with_mission_item(s: Subject) -> str:
    return missions.upload(s.client, [waypoint(s, 10.0, 0.0)], _FENCE).ack


def _terrain(s: Subject) -> str:
    """Terrain-frame items are uploaded, and then arming is asked for."""
    frame = mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT
    items = [
        Item(TAKEOFF, *s.place(0.0, 0.0), 20.0),
        Item(WAYPOINT, *s.place(50.0, 0.0), 20.0, frame=frame),
    ]
    done = s.upload(items)
    s.client.collect(3.0)
    answer = s.arm_once()
    s.client.collect(0.5)
    s.disarm_once()
    return f"{done.ack}, arming {answer}"


def _jump_on_ground(s: Subject) -> str:
    """DO_SET_MISSION_CURRENT while disarmed, and MISSION_CURRENT after it."""
    s.upload(_probe(s))
    s.client.collect(3.0)
    wanted = s.first_seq() + 2
    answer = s.client.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, float(wanted))
    s.client.collect(1.2)
    return f"{answer}, {'there' if _current(s).seq == wanted else 'not there'}"


def _set_current_on_ground(s: Subject) -> str:
    s.upload(_probe(s))
    s.client.collect(3.0)
    wanted = s.first_seq() + 2
    s.client.send("MISSION_SET_CURRENT", seq=wanted)
    s.client.collect(1.2)
    return "there" if _current(s).seq == wanted else "not there"


def _set_current_wrong(s: Subject) -> str:
    """A number that is not in the list."""
    s.upload(_probe(s))
    before = _current(s).seq
    s.client.send("MISSION_SET_CURRENT", seq=77)
    s.client.collect(1.2)
    return "ignored" if _current(s).seq == before else f"now at {_current(s).seq}"


BEHAVIOURS = (
    Behaviour("mission/asked_with", "An upload is asked for with", _asked_with),
    Behaviour("mission/accepted", "A whole upload is", _answered),
    Behaviour("mission/count", "Items counted beyond those meant to fly", _count),
    Behaviour("mission/item_0", "Item 0, a waypoint elsewhere, is", _first_item),
    Behaviour("mission/frame_6", "An item in frame 6 reads back in frame", _frame(1)),
    Behaviour("mission/frame_0", "An item in frame 0 reads back in frame", _frame(2)),
    Behaviour("mission/frame_2", "A DO item in frame 2 reads back in frame", _frame(3)),
    Behaviour("mission/nan", "A waypoint's NaN yaw reads back as", _nan),
    Behaviour("mission/radius", f"A waypoint's radius of {_RADIUS_M:g} reads back as", _radius),
    Behaviour("mission/change_speed", "A DO_CHANGE_SPEED item is", _change_speed),
    Behaviour("mission/old_request", "MISSION_REQUEST is answered with", _item_message),
    Behaviour("mission/total", "MISSION_CURRENT.total beyond the items sent", _total),
    Behaviour("mission/total_empty", "MISSION_CURRENT.total without a mission", _total_empty),
    Behaviour("mission/partial", "A partial write on the ground is", _partial),
    Behaviour("mission/clear", "Clearing on the ground is", _clear),
    Behaviour("mission/empty_upload", "An upload of 0 items is", _empty_upload),
    Behaviour("mission/out_of_order", "An item asked for out of turn gives", _out_of_order),
    Behaviour("mission/unfinished_download", "An upload amid a download is", _unfinished_download),
    Behaviour("mission/cut_on_ground", "After an upload that breaks off there is", _cut_on_ground),
    Behaviour("mission/terrain", "A mission in the terrain frame, then arming, is", _terrain),
    Behaviour("mission/jump_on_ground", "DO_SET_MISSION_CURRENT, disarmed, is", _jump_on_ground),
    Behaviour(
        "mission/set_current_on_ground", "MISSION_SET_CURRENT, disarmed, is", _set_current_on_ground
    ),
    Behaviour(
        "mission/set_current_wrong", "MISSION_SET_CURRENT beyond the list is", _set_current_wrong
    ),
    Behaviour("fence/upload", "A fence polygon is", _fence),
    Behaviour("fence/wrong_item", "A waypoint uploaded as a fence is", _fence_with_mission_item),
    Behaviour("fence/rally", "A rally point is", _rally),
)
