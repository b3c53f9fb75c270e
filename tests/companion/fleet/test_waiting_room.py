"""What waits for a member: the newest or the first, and what found no room handed back."""

from companion.fleet.network import Ask, Asked
from companion.fleet.waiting_room import WaitingRoom


def word(text: str) -> Asked:
    return Asked(Ask.COMMAND, lambda replies: None, text.encode())


def test_what_finds_no_room_is_handed_back_and_counted() -> None:
    room = WaitingRoom()
    first, second, third = (word(text) for text in ("a", "b", "c"))
    assert room.put("desk", first, 2) is None
    assert room.put("desk", second, 2) is None
    assert room.put("desk", third, 2) is first
    assert room.put("desk", first, 2, keep_first=True) is first
    assert room.put("other", first, 2) is None
    assert room.dropped("desk") == 2
    assert room.dropped("desk") == 0
    assert room.take() == [second, third, first]
    assert room.take() == []
