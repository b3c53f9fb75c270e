"""Bounded queue per sender: keep the latest or the first, return what was dropped."""

from companion.fleet.network import MemberRequest, RequestKind
from companion.fleet.request_queue import RequestQueues


def word(text: str) -> MemberRequest:
    return MemberRequest(RequestKind.COMMAND, lambda replies: None, text.encode())


def test_what_finds_no_room_is_handed_back_and_counted() -> None:
    dropped: list[MemberRequest] = []
    room = RequestQueues(release=dropped.append)
    first, second, third = (word(text) for text in ("a", "b", "c"))
    room.add_to_queue_and_call_back("desk", first, 2)
    room.add_to_queue_and_call_back("desk", second, 2)
    assert dropped == []
    room.add_to_queue_and_call_back("desk", third, 2)
    assert dropped == [first]
    room.add_to_queue_and_call_back("desk", second, 2, keep_first=True)
    room.add_to_queue_and_call_back("other", first, 2)
    assert dropped == [first, second]
    assert room.pop_dropped_count("desk") == 2
    assert room.pop_dropped_count("desk") == 0
    assert room.drain_in_arrival_order() == [second, third, first]
    assert room.drain_in_arrival_order() == []
