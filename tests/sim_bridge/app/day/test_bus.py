"""The fleet's network in one process behaves as zenoh does where the desk can tell."""

import numpy as np

from companion.core.separation.track import Track
from companion.fleet.messages import (
    Answered,
    Command,
    Recall,
    Refused,
    Result,
    State,
    decode_told_track,
    encode,
)
from companion.fleet.network import Ask
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)
from sim_bridge.app.day.bus import Bus, BusLink

RECALL = Command(id="c1", vehicle="d1", life="l1", as_of_s=0.0, by="desk", deed=Recall())


def bus(loss: float = 0.0) -> Bus:
    return Bus(np.random.default_rng(1), loss)


def state(vehicle: str = "d1") -> bytes:
    told = State(
        vehicle=vehicle, life="l1", uptime_s=1.0, epoch_us=0, airframe="m100",
        max_payload_kg=1.0, phase="standby", log="a", last_seq=0,
    )  # fmt: skip
    return encode(told)


def track(vehicle: str, lat_deg: float) -> bytes:
    told = Track(
        vehicle=vehicle, gnss_s=1.8e9, lat_deg=lat_deg, lon_deg=8.45, alt_amsl_m=50.0,
        vel_n_mps=0.0, vel_e_mps=0.0, vel_d_mps=0.0, pos_std_m=2.0, alt_std_m=0.5, vel_std_mps=0.1,
    )  # fmt: skip
    return encode(told)


def answer(link: BusLink) -> None:
    result = encode(Result(id="c1", vehicle="d1", life="l1", answer=Answered.DONE))
    for asked in link.asked():
        assert asked.ask is Ask.COMMAND
        asked.answer([result])
        asked.answer([result])


def test_a_desk_that_joins_late_sees_who_lives_and_gets_the_newest_states_on_asking():
    net = bus()
    net.join("d1", "l1").publish_state(state())
    desk = net.desk()
    net.deliver(1.0)
    assert desk.receive(0.0) == [LivelinessChanged("d1", "l1", up=True)]
    desk.ask_states(5.0)
    net.deliver(2.0)
    (heard,) = desk.receive(0.0)
    assert isinstance(heard, StateReceived)


def test_a_command_is_answered_once_though_the_vehicle_answers_twice():
    net = bus()
    link, desk = net.join("d1", "l1"), net.desk()
    desk.send(RECALL, 5.0)
    net.deliver(1.0)
    answer(link)
    net.deliver(20.0)
    answers = [h for h in desk.receive(0.0) if isinstance(h, CommandAnswered)]
    assert [h.result is not None for h in answers] == [True]


def test_a_command_to_nobody_is_visibly_not_answered_in_its_time():
    net = bus()
    desk = net.desk()
    desk.send(RECALL, 5.0)
    net.deliver(4.9)
    assert desk.receive(0.0) == []
    net.deliver(5.1)
    assert desk.receive(0.0) == [CommandAnswered("c1", None)]


def test_a_killed_member_is_seen_to_go_and_its_second_life_is_a_twin_to_none():
    net = bus()
    desk, link = net.desk(), net.join("d1", "l1")
    link.close()
    second = net.join("d1", "l2")
    net.deliver(1.0)
    lives = [(h.life, h.up) for h in desk.receive(0.0) if isinstance(h, LivelinessChanged)]
    assert lives == [("l1", True), ("l1", False), ("l2", True)]
    assert second.asked() == []


def test_two_lives_at_once_hear_of_each_other():
    net = bus()
    one, two = net.join("d1", "l1"), net.join("d1", "l2")
    net.deliver(1.0)
    assert [a.ask for a in one.asked()] == [a.ask for a in two.asked()] == [Ask.TWIN]


def test_who_speaks_for_another_is_not_believed():
    net = bus()
    desk = net.desk()
    net.join("d1", "l1").publish_state(state("d2"))
    net.deliver(1.0)
    assert any(isinstance(h, MessageRejected) for h in desk.receive(0.0))
    assert not any(isinstance(h, StateReceived) for h in desk.receive(0.0))


def test_of_many_messages_the_stated_share_is_lost():
    """Binomial: 2000 messages at 0.2 lose 400 with a standard deviation of 18."""
    net = bus(0.2)
    desk, link = net.desk(), net.join("d1", "l1")
    for _ in range(2000):
        link.publish_state(state())
    net.deliver(1.0)
    arrived = sum(isinstance(h, StateReceived) for h in desk.receive(0.0))
    assert arrived == 2000 - net.lost
    assert abs(net.lost - 400) < 4 * 18


def alive(desk) -> list[bool]:
    return [one.up for one in desk.receive(0.0) if isinstance(one, LivelinessChanged)]


def test_while_the_network_is_cut_nothing_passes_and_members_are_gone_after_the_lease():
    net = bus()
    link, desk = net.join("d1", "l1"), net.desk()
    net.deliver(1.0)
    assert alive(desk) == [True]
    net.cut(30.0)
    link.publish_state(state())
    net.deliver(10.0)
    assert not desk.receive(0.0)
    net.deliver(12.0)
    assert alive(desk) == [False]
    net.deliver(32.0)
    assert alive(desk) == [True]
    link.publish_state(state())
    net.deliver(33.0)
    assert isinstance(desk.receive(0.0)[0], StateReceived)


def test_a_cut_within_the_lease_is_only_a_silence():
    net = bus()
    desk = net.desk()
    net.join("d1", "l1")
    net.deliver(1.0)
    assert alive(desk) == [True]
    net.cut(5.0)
    net.deliver(20.0)
    assert not desk.receive(0.0)


def test_who_joins_and_leaves_during_a_cut_is_known_when_it_is_over():
    net = bus()
    gone, desk = net.join("d1", "l1"), net.desk()
    net.deliver(1.0)
    desk.receive(0.0)
    net.cut(30.0)
    net.join("d2", "l2")
    gone.close()
    net.deliver(29.0)
    assert not alive(desk)[1:]
    net.deliver(32.0)
    told = [one for one in desk.receive(0.0) if isinstance(one, LivelinessChanged)]
    assert {one.vehicle: one.up for one in told} == {"d1": False, "d2": True}


def test_a_member_that_is_cut_off_is_not_heard_and_the_others_are():
    net = bus()
    lost, heard, desk = net.join("d1", "l1"), net.join("d2", "l2"), net.desk()
    net.deliver(1.0)
    desk.receive(0.0)
    net.cut_off("d1", 60.0)
    for link, vehicle in ((lost, "d1"), (heard, "d2")):
        link.publish_state(state(vehicle))
    net.deliver(2.0)
    (came,) = desk.receive(0.0)
    assert isinstance(came, StateReceived)
    assert came.state.vehicle == "d2"


def test_a_member_that_is_cut_off_is_gone_after_the_lease_and_then_is_back():
    net = bus()
    net.join("d1", "l1")
    desk = net.desk()
    net.deliver(1.0)
    desk.receive(0.0)
    net.cut_off("d1", 60.0)
    net.deliver(30.0)
    assert desk.receive(0.0) == [LivelinessChanged("d1", "l1", up=False)]
    net.deliver(70.0)
    assert desk.receive(0.0) == [LivelinessChanged("d1", "l1", up=True)]


def test_a_track_comes_to_those_who_listen_near_the_place_that_it_tells():
    net = bus()
    near, far, told, silent = (net.join(f"d{n}", "l1") for n in range(1, 5))
    near.hear_near(55.47, 8.45)
    far.hear_near(55.50, 8.45)
    told.hear_near(55.47, 8.45)
    raw = track("d3", 55.47)
    told.publish_track(raw, "1/1")
    net.deliver(1.0)
    assert [(heard.speaker, heard.raw) for heard in near.tracks()] == [("d3", raw)]
    assert far.tracks() == told.tracks() == silent.tracks() == []
    net.spoil = lambda raw, t_s: track("d3", 55.50)  # its receiver is wrong by 3 km
    told.publish_track(raw, "1/1")
    net.deliver(2.0)
    assert near.tracks() == []
    (heard,) = far.tracks()
    assert not isinstance(decode_told_track(heard), Refused)
