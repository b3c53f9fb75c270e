"""Lockstep against scripted clients on a scripted clock, and one over real UDP."""

import socket
import threading
from collections import deque
from collections.abc import Callable, Collection
from contextlib import closing

import pytest

from sim_bridge.adapters.endpoint import EndpointSet
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

AUTOPILOT = Encoder(1, 1)
COMPANION = Encoder(1, 191)
LIMIT_S = 5.0
STEP_NS = 100_000_000


def timesync(encoder: Encoder, tc1: int, ts1: int) -> bytes:
    return encoder.encode_next_frame(Message("TIMESYNC", tc1=tc1, ts1=ts1))


def answer(t_ns: int) -> bytes:
    return timesync(COMPANION, t_ns + 1, t_ns)


def heartbeat() -> bytes:
    return COMPANION.encode_next_frame(
        Message("HEARTBEAT", type=18, autopilot=8, base_mode=0, custom_mode=0, system_status=4)
    )


def text(words: str) -> bytes:
    return COMPANION.encode_next_frame(Message("STATUSTEXT", severity=6, text=words))


def request(_: int, t_ns: int) -> list[bytes]:
    return [text("telemetry") + timesync(AUTOPILOT, 0, t_ns)]


class ScriptedEndpoints:
    """Replaces an EndpointSet: clients respond by a function; waiting advances the clock."""

    def __init__(self, replies: dict[int, Callable[[int], list[bytes]]]) -> None:
        self.replies = replies
        self.now_s = 0.0
        self.sent: list[tuple[int, bytes]] = []
        self._p_home_at_end: deque[tuple[int, bytes]] = deque()

    def send(self, number: int, data: bytes) -> None:
        self.sent.append((number, data))
        for message in Decoder().decode_bytes(data):
            if message.msg_name == "TIMESYNC" and number in self.replies:
                self._p_home_at_end += [(number, d) for d in self.replies[number](message.ts1)]

    def poll(self, timeout_s: float) -> list[tuple[int, bytes]]:
        if self._p_home_at_end:
            return [self._p_home_at_end.popleft()]
        self.now_s += timeout_s
        return []


def lockstep_of(
    endpoints: ScriptedEndpoints, *clients: int, ended: Collection[int] = ()
) -> Lockstep:
    return Lockstep(
        endpoints,  # type: ignore[arg-type]
        clients,
        request,
        limit_s=LIMIT_S,
        clock_s=lambda: endpoints.now_s,
        is_alive=lambda number: number not in ended,
    )


def alive(t_ns: int) -> list[bytes]:
    return [text(f"at {t_ns}"), answer(t_ns)]


def test_telemetry_goes_before_the_request_and_outputs_come_back_before_the_answer() -> None:
    endpoints = ScriptedEndpoints({0: alive})
    lockstep = lockstep_of(endpoints, 0)
    lockstep.wait_until_clients_respond(0, LIMIT_S)
    endpoints.sent.clear()
    gathered = lockstep.exchange_one_step(STEP_NS)
    sent = [m.msg_name for _, data in endpoints.sent for m in Decoder().decode_bytes(data)]
    assert sent == ["STATUSTEXT", "TIMESYNC"]
    (first, *_) = Decoder().decode_bytes(gathered.received[0][1])
    assert first.text == f"at {STEP_NS}"
    assert endpoints.now_s == 0.0


def test_all_live_clients_are_waited_for_and_heard_in_the_order_of_their_endpoints() -> None:
    endpoints = ScriptedEndpoints({2: alive, 0: alive})
    lockstep = lockstep_of(endpoints, 2, 0)
    lockstep.wait_until_clients_respond(0, LIMIT_S)
    gathered = lockstep.exchange_one_step(STEP_NS)
    assert [number for number, _ in gathered.received] == [0, 0, 2, 2]
    assert lockstep.live_clients == {0, 2}


def test_the_answer_may_share_a_datagram_with_other_frames() -> None:
    endpoints = ScriptedEndpoints({0: lambda t_ns: [text("a") + answer(t_ns) + text("b")]})
    lockstep = lockstep_of(endpoints, 0)
    assert lockstep.wait_until_clients_respond(0, LIMIT_S).timed_out == ()


def test_a_client_that_falls_silent_is_waited_for_once() -> None:
    endpoints = ScriptedEndpoints({0: alive})
    lockstep = lockstep_of(endpoints, 0)
    lockstep.wait_until_clients_respond(0, LIMIT_S)
    endpoints.replies = {}
    assert lockstep.exchange_one_step(STEP_NS).timed_out == (0,)
    assert endpoints.now_s == pytest.approx(LIMIT_S)
    assert lockstep.exchange_one_step(2 * STEP_NS).timed_out == ()
    assert endpoints.now_s == pytest.approx(LIMIT_S)


@pytest.mark.parametrize("sign_of_life", [lambda _: [heartbeat()], lambda t: [answer(t)]])
def test_a_dead_client_that_speaks_again_is_waited_for_again(sign_of_life) -> None:
    endpoints = ScriptedEndpoints({})
    lockstep = lockstep_of(endpoints, 0)
    lockstep.exchange_one_step(0)
    endpoints.replies = {0: sign_of_life}
    assert lockstep.exchange_one_step(STEP_NS).revived == (0,)
    assert lockstep.live_clients == {0}
    endpoints.replies = {}
    assert lockstep.exchange_one_step(2 * STEP_NS).timed_out == (0,)


def test_talk_is_no_sign_of_life() -> None:
    endpoints = ScriptedEndpoints({0: lambda _: [text("still here")]})
    lockstep = lockstep_of(endpoints, 0)
    assert lockstep.exchange_one_step(0).revived == ()
    assert lockstep.live_clients == frozenset()


@pytest.mark.parametrize(
    "reply",
    [
        lambda t_ns: [answer(t_ns - STEP_NS)],  # of an earlier step
        lambda t_ns: [timesync(COMPANION, 0, t_ns)],  # a request of the client
        lambda t_ns: [answer(t_ns)[:-1] + b"\0"],  # damaged
        lambda t_ns: [answer(t_ns)[:-3]],  # truncated
        lambda t_ns: [b"\xfd" * 12, b"\xfe", b""],
    ],
)
def test_only_the_echo_of_this_very_time_ends_a_turn(reply) -> None:
    endpoints = ScriptedEndpoints({0: alive})
    lockstep = lockstep_of(endpoints, 0)
    lockstep.wait_until_clients_respond(0, LIMIT_S)
    endpoints.replies = {0: reply}
    assert lockstep.exchange_one_step(STEP_NS).timed_out == (0,)


def test_a_mavlink_1_client_can_take_part() -> None:
    old = Encoder(1, 191, version=1)
    endpoints = ScriptedEndpoints({0: lambda t_ns: [timesync(old, t_ns + 1, t_ns)]})
    assert lockstep_of(endpoints, 0).wait_until_clients_respond(0, LIMIT_S).timed_out == ()


def test_clients_that_are_not_up_yet_are_asked_again() -> None:
    endpoints = ScriptedEndpoints({})
    endpoints.replies = {0: lambda t_ns: [answer(t_ns)] if endpoints.now_s > 3.0 else []}
    lockstep = lockstep_of(endpoints, 0, 1)
    assert lockstep.wait_until_clients_respond(0, LIMIT_S).timed_out == (1,)
    assert lockstep.live_clients == {0}
    asked_of_0 = [number for number, _ in endpoints.sent].count(0)
    assert 3.0 / 0.25 <= asked_of_0 <= 3.0 / 0.25 + 2


def test_a_client_whose_process_has_ended_is_not_waited_for() -> None:
    ended: set[int] = set()
    endpoints = ScriptedEndpoints({0: alive, 1: alive})
    lockstep = lockstep_of(endpoints, 0, 1, ended=ended)
    lockstep.wait_until_clients_respond(0, LIMIT_S)
    endpoints.replies = {1: alive}
    ended.add(0)
    began_s = endpoints.now_s
    gathered = lockstep.exchange_one_step(STEP_NS)
    assert gathered.timed_out == (0,)
    assert [number for number, _ in gathered.received] == [1, 1]
    assert endpoints.now_s - began_s <= 0.2


def test_the_last_words_of_a_client_that_ends_after_its_answer_are_heard() -> None:
    ended: set[int] = set()
    endpoints = ScriptedEndpoints({0: alive})
    lockstep = lockstep_of(endpoints, 0, ended=ended)
    lockstep.wait_until_clients_respond(0, LIMIT_S)
    ended.add(0)
    gathered = lockstep.exchange_one_step(STEP_NS)
    assert gathered.timed_out == ()
    assert len(gathered.received) == 2


def test_a_client_that_ends_before_it_comes_up_is_not_waited_for() -> None:
    endpoints = ScriptedEndpoints({})
    assert lockstep_of(endpoints, 0, ended=[0]).wait_until_clients_respond(
        0, LIMIT_S
    ).timed_out == (0,)
    assert endpoints.now_s == 0.0


def test_datagrams_of_links_without_lockstep_are_gathered_too() -> None:
    endpoints = ScriptedEndpoints({0: alive, 1: lambda _: []})
    lockstep = lockstep_of(endpoints, 0)
    lockstep.wait_until_clients_respond(0, LIMIT_S)
    endpoints._p_home_at_end.append((1, heartbeat()))
    assert [number for number, _ in lockstep.exchange_one_step(STEP_NS).received] == [0, 0, 1]
    assert lockstep.live_clients == {0}


def test_a_hundred_steps_over_real_udp_lose_nothing() -> None:
    steps = 100
    with (
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as client,
        EndpointSet(["udpin::0"]) as endpoints,
    ):
        client.settimeout(10.0)
        client.connect(("127.0.0.1", int(endpoints.urls[0].rsplit(":", 1)[1])))
        client.send(heartbeat())  # the server has to learn the listener's address first
        endpoints.poll(10.0)

        def companion() -> None:
            last_ns = -1
            while last_ns < steps * STEP_NS:
                for message in Decoder().decode_bytes(client.recv(2048)):
                    if message.msg_name == "TIMESYNC":
                        last_ns = message.ts1
                        client.send(text(f"at {last_ns}"))
                        client.send(answer(last_ns))

        thread = threading.Thread(target=companion)
        thread.start()
        lockstep = Lockstep(endpoints, [0], request)
        lockstep.wait_until_clients_respond(0, 10.0)
        for step in range(1, steps + 1):
            gathered = lockstep.exchange_one_step(step * STEP_NS)
            words = [
                m.text
                for _, d in gathered.received
                for m in Decoder().decode_bytes(d)[:1]
                if m.msg_id == 253
            ]
            assert words == [f"at {step * STEP_NS}"]
        thread.join()
