"""The in-process fleet network behaves as zenoh does, as far as the desk can observe."""

import numpy as np
import pytest

from companion.core.separation.track import Track
from companion.fleet.messages import (
    Command,
    CommandStatus,
    Recall,
    Refused,
    Result,
    State,
    encode_message,
)
from companion.fleet.network import RequestKind
from companion.fleet.signed_link import decode_and_match_received_track
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)
from sim_bridge.app.day.bus import Bus, BusLink

RECALL = Command(id="c1", vehicle="d1", instance_id="l1", as_of_s=0.0, by="desk", action=Recall())


def bus(loss: float = 0.0) -> Bus:
    return Bus(np.random.default_rng(1), loss)


def state(vehicle: str = "d1") -> bytes:
    told = State(
        vehicle=vehicle, instance_id="l1", uptime_s=1.0, epoch_us=0, airframe="m100",
        max_payload_kg=1.0, phase="standby", log="a", last_seq=0,
    )  # fmt: skip
    return encode_message(told)


def track(vehicle: str, lat_deg: float) -> bytes:
    told = Track(
        vehicle=vehicle, gnss_s=1.8e9, lat_deg=lat_deg, lon_deg=8.45, alt_amsl_m=50.0,
        vel_n_mps=0.0, vel_e_mps=0.0, vel_d_mps=0.0, pos_std_m=2.0, alt_std_m=0.5, vel_std_mps=0.1,
    )  # fmt: skip
    return encode_message(told)


def answer(link: BusLink) -> None:
    result = encode_message(
        Result(id="c1", vehicle="d1", instance_id="l1", status=CommandStatus.DONE)
    )
    for asked in link.drain_requests():
        assert asked.kind is RequestKind.COMMAND
        asked.reply([result])
        asked.reply([result])


def test_a_desk_that_joins_late_sees_who_lives_and_gets_the_newest_states_on_asking():
    net = bus()
    net.join("d1", "l1").publish_state(state())
    desk = net.add_desk()
    net.advance_and_run_due_calls(1.0)
    assert desk.receive(0.0) == [LivelinessChanged("d1", "l1", has_joined=True)]
    desk.request_states(5.0)
    net.advance_and_run_due_calls(2.0)
    (heard,) = desk.receive(0.0)
    assert isinstance(heard, StateReceived)


def test_a_command_is_answered_once_though_the_vehicle_answers_twice():
    net = bus()
    link, desk = net.join("d1", "l1"), net.add_desk()
    desk.send(RECALL, 5.0)
    net.advance_and_run_due_calls(1.0)
    answer(link)
    net.advance_and_run_due_calls(20.0)
    answers = [h for h in desk.receive(0.0) if isinstance(h, CommandResponse)]
    assert [h.result is not None for h in answers] == [True]


def test_a_command_to_nobody_is_visibly_not_answered_in_its_time():
    net = bus()
    desk = net.add_desk()
    desk.send(RECALL, 5.0)
    net.advance_and_run_due_calls(4.9)
    assert desk.receive(0.0) == []
    net.advance_and_run_due_calls(5.1)
    assert desk.receive(0.0) == [CommandResponse("c1", None)]


def test_a_killed_member_is_seen_to_go_and_its_second_life_is_a_twin_to_none():
    net = bus()
    desk, link = net.add_desk(), net.join("d1", "l1")
    link.close()
    second = net.join("d1", "l2")
    net.advance_and_run_due_calls(1.0)
    lives = [
        (h.instance_id, h.has_joined) for h in desk.receive(0.0) if isinstance(h, LivelinessChanged)
    ]
    assert lives == [("l1", True), ("l1", False), ("l2", True)]
    assert second.drain_requests() == []


def test_two_lives_at_once_hear_of_each_other():
    net = bus()
    one, two = net.join("d1", "l1"), net.join("d1", "l2")
    net.advance_and_run_due_calls(1.0)
    assert (
        [a.kind for a in one.drain_requests()]
        == [a.kind for a in two.drain_requests()]
        == [RequestKind.DUPLICATE]
    )


def test_who_speaks_for_another_is_not_believed():
    net = bus()
    desk = net.add_desk()
    net.join("d1", "l1").publish_state(state("d2"))
    net.advance_and_run_due_calls(1.0)
    kinds = {type(heard) for heard in desk.receive(0.0)}
    assert MessageRejected in kinds
    assert StateReceived not in kinds


def test_of_many_messages_the_stated_share_is_lost():
    """Binomial: 2000 messages at 0.2 lose 400 with a standard deviation of 18."""
    net = bus(0.2)
    desk, link = net.add_desk(), net.join("d1", "l1")
    for _ in range(2000):
        link.publish_state(state())
    net.advance_and_run_due_calls(1.0)
    arrived = sum(isinstance(h, StateReceived) for h in desk.receive(0.0))
    assert arrived == 2000 - net.lost
    assert abs(net.lost - 400) < 4 * 18


def alive(desk) -> list[bool]:
    return [one.has_joined for one in desk.receive(0.0) if isinstance(one, LivelinessChanged)]


@pytest.mark.parametrize(
    ("cut", "for_s", "gone_s", "back_s"),
    [
        (Bus.cut_network, 30.0, 12.0, 32.0),
        (Bus.cut_network, 5.0, None, 20.0),  # within the lease a cut only delays messages
        (lambda net, for_s: net.cut_member("d1", for_s), 60.0, 30.0, 70.0),
    ],
    ids=["network", "short", "member"],
)
def test_while_it_is_cut_nothing_passes_and_members_are_gone_after_the_lease(
    cut, for_s, gone_s, back_s
):
    net = bus()
    link, desk = net.join("d1", "l1"), net.add_desk()
    net.advance_and_run_due_calls(1.0)
    assert alive(desk) == [True]
    cut(net, for_s)
    link.publish_state(state())
    net.advance_and_run_due_calls(10.0)
    assert not desk.receive(0.0)
    if gone_s is not None:
        net.advance_and_run_due_calls(gone_s)
        assert desk.receive(0.0) == [LivelinessChanged("d1", "l1", has_joined=False)]
    net.advance_and_run_due_calls(back_s)
    assert alive(desk) == [True] * (gone_s is not None)
    link.publish_state(state())
    net.advance_and_run_due_calls(back_s + 1.0)
    assert [type(heard) for heard in desk.receive(0.0)] == [StateReceived]


def test_who_joins_and_leaves_during_a_cut_is_known_when_it_is_over():
    net = bus()
    gone, desk = net.join("d1", "l1"), net.add_desk()
    net.advance_and_run_due_calls(1.0)
    desk.receive(0.0)
    net.cut_network(30.0)
    net.join("d2", "l2")
    gone.close()
    net.advance_and_run_due_calls(29.0)
    assert not alive(desk)[1:]
    net.advance_and_run_due_calls(32.0)
    told = [one for one in desk.receive(0.0) if isinstance(one, LivelinessChanged)]
    assert {one.vehicle: one.has_joined for one in told} == {"d1": False, "d2": True}


def test_a_member_that_is_cut_off_is_not_heard_and_the_others_are():
    net = bus()
    lost, heard, desk = net.join("d1", "l1"), net.join("d2", "l2"), net.add_desk()
    net.advance_and_run_due_calls(1.0)
    desk.receive(0.0)
    net.cut_member("d1", 60.0)
    for link, vehicle in ((lost, "d1"), (heard, "d2")):
        link.publish_state(state(vehicle))
    net.advance_and_run_due_calls(2.0)
    (came,) = desk.receive(0.0)
    assert isinstance(came, StateReceived)
    assert came.state.vehicle == "d2"


def test_a_track_comes_to_those_who_listen_near_the_place_that_it_tells():
    net = bus()
    near, far, told, silent = (net.join(f"d{n}", "l1") for n in range(1, 5))
    near.subscribe_near(55.47, 8.45)
    far.subscribe_near(55.50, 8.45)
    told.subscribe_near(55.47, 8.45)
    raw = track("d3", 55.47)
    told.publish_track(raw, "1/1")
    net.advance_and_run_due_calls(1.0)
    assert [(heard.sender, heard.raw) for heard in near.drain_tracks()] == [("d3", raw)]
    assert far.drain_tracks() == told.drain_tracks() == silent.drain_tracks() == []
    net.distort_track = lambda raw, t_s: track("d3", 55.50)  # its receiver is off by 3 km
    told.publish_track(raw, "1/1")
    net.advance_and_run_due_calls(2.0)
    assert near.drain_tracks() == []
    (heard,) = far.drain_tracks()
    assert not isinstance(decode_and_match_received_track(heard), Refused)
