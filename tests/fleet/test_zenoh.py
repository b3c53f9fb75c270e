"""Vehicle and desk over zenoh on loopback."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from companion.core.mission.actions import PublishTrack
from companion.fleet.command_log import CommandReply
from companion.fleet.messages import (
    Command,
    CommandAction,
    CommandStatus,
    EventKind,
    Launch,
    Recall,
)
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import (
    CommandResponse,
    EventsReceived,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)
from tests.fleet.wire import valid_from
from tests.fleet.zenoh_net import FLEET, HERE, Vehicle, config_file, free_port

PATIENCE_S = 20.0


class Desk:
    """A ZenohFleet that keeps all received messages."""

    def __init__(self, config: Path) -> None:
        self.fleet = ZenohFleet(FLEET, config)
        self.heard: list[FleetInput] = []

    def until(self, wanted: Callable[[FleetInput], Any]) -> Any:
        """Wait for the first received message that matches, and return it."""
        seen, limit_s = 0, monotonic_s() + PATIENCE_S
        while monotonic_s() < limit_s:
            self.heard += self.fleet.receive(0.05)
            for heard in self.heard[seen:]:
                found = wanted(heard)
                if found is not None:
                    return found
            seen = len(self.heard)
        raise AssertionError(f"not heard within {PATIENCE_S} s; last: {self.heard[-3:]}")

    def state(self, **fields: object) -> StateReceived:
        return self.until(
            lambda h: (
                h
                if isinstance(h, StateReceived)
                and all(getattr(h.state, k) == v for k, v in fields.items())
                else None
            )
        )

    def response(self, command: Command) -> CommandResponse:
        self.heard.clear()
        self.fleet.send(command, 2.0)
        return self.until(
            lambda h: h if isinstance(h, CommandResponse) and h.command_id == command.id else None
        )


@pytest.fixture
def net(tmp_path: Path) -> Iterator[tuple[Callable[..., Vehicle], Callable[[], Desk]]]:
    """Create vehicles and desks of one network; the desk listens."""
    port = free_port()
    ours = config_file(tmp_path / "desk.json5", listen=port)
    theirs = config_file(tmp_path / "vehicle.json5", connect=port)
    made: list[Any] = []

    def vehicle(name: str = "d1", folder: str | None = None) -> Vehicle:
        made.append(Vehicle(name, tmp_path / (folder or name), theirs))
        return made[-1]

    def desk() -> Desk:
        made.append(Desk(ours))
        return made[-1]

    yield vehicle, desk
    for thing in made:
        (thing.fleet if isinstance(thing, Desk) else thing).close()


def a_command(vehicle: Vehicle, deed: CommandAction, id_: str = "c1") -> Command:
    port = vehicle.port
    deed = valid_from(deed, port.member.instance_id, port.member.uptime_s)
    return Command(
        id=id_,
        vehicle=port.member.vehicle,
        instance_id=port.member.instance_id,
        as_of_s=port.member.uptime_s,
        by="desk",
        action=deed,
    )


def alive(life: str, up: bool) -> Callable[[FleetInput], Any]:
    return lambda h: h if h == LivelinessChanged("d1", life, up) else None


def test_a_vehicle_comes_tells_its_state_and_goes(net):
    make_vehicle, make_desk = net
    desk = make_desk()
    vehicle = make_vehicle()
    desk.until(alive(vehicle.port.member.instance_id, True))
    assert desk.state(phase="standby").state.airframe == "m100"
    desk.state(instance_id=vehicle.port.member.instance_id)
    assert (
        LivelinessChanged("d1", vehicle.port.member.instance_id, has_joined=False) not in desk.heard
    )
    vehicle.close()
    desk.until(alive(vehicle.port.member.instance_id, False))


def test_a_desk_that_comes_late_gets_picture_and_past_at_once(net):
    make_vehicle, make_desk = net
    vehicle = make_vehicle()
    for n in range(5):
        vehicle.port.record_event(EventKind.TEXT, f"words {n}")
    desk = make_desk()
    desk.until(alive(vehicle.port.member.instance_id, True))
    desk.fleet.request_states(2.0)
    state = desk.state(last_seq=5).state
    desk.fleet.request_events("d1", 2, 2.0)
    replay = desk.until(lambda h: h if isinstance(h, EventsReceived) and h.replayed else None)
    assert [(e.seq, e.text) for e in replay.events] == [(n, f"words {n - 1}") for n in (3, 4, 5)]
    assert replay.events[0].log == state.log


def test_a_command_sent_again_is_carried_out_once_and_answered_the_same(net):
    make_vehicle, make_desk = net
    desk, vehicle = make_desk(), make_vehicle()
    desk.state()
    command = a_command(vehicle, Launch(assignment="o1.1"))
    answers = [desk.response(command).result for _ in range(3)]
    assert [(a.status, a.reason) for a in answers] == [(CommandStatus.DONE, "done")] * 3
    assert len(vehicle.done) == 1


def test_a_companion_that_restarts_still_knows_what_it_was_told(net):
    make_vehicle, make_desk = net
    desk, first = make_desk(), make_vehicle()
    desk.state()
    command = a_command(first, Launch(assignment="o1.1"))
    assert desk.response(command).result.status is CommandStatus.DONE
    first.close()
    second = make_vehicle()
    desk.state(instance_id=second.port.member.instance_id)
    again = desk.response(command).result
    assert (again.status, again.reason, again.instance_id) == (
        CommandStatus.DONE,
        "done",
        second.port.member.instance_id,
    )
    assert second.done == []
    new = desk.response(a_command(first, Launch(assignment="o2.1"), "c2")).result
    assert new.status is CommandStatus.EXPIRED


def test_nobody_there_is_an_answer_too(net):
    make_vehicle, make_desk = net
    desk, vehicle = make_desk(), make_vehicle()
    desk.state()
    command = a_command(vehicle, Recall())
    vehicle.close()
    desk.until(alive(vehicle.port.member.instance_id, False))
    assert desk.response(command).result is None


def test_not_now_is_carried_out_when_asked_again(net):
    make_vehicle, make_desk = net
    desk, vehicle = make_desk(), make_vehicle()
    desk.state()
    command = a_command(vehicle, Launch(assignment="o1.1"))
    vehicle.answer = CommandReply(CommandStatus.LATER, "planning")
    assert desk.response(command).result.status is CommandStatus.LATER
    vehicle.answer = CommandReply(CommandStatus.DONE)
    assert desk.response(command).result.status is CommandStatus.DONE
    assert len(vehicle.done) == 2


def test_a_ground_that_was_away_hears_what_happened_meanwhile(net):
    make_vehicle, make_desk = net
    desk, vehicle = make_desk(), make_vehicle()
    desk.state()
    desk.fleet.close()
    vehicle.port.record_event(EventKind.OUTCOME, "home", outcome="SUC", delivered=True, home=True)
    back = make_desk()
    back.state(last_seq=1)
    back.fleet.request_events("d1", 0, 2.0)
    replay = back.until(lambda h: h if isinstance(h, EventsReceived) and h.replayed else None)
    assert [e.outcome for e in replay.events] == ["SUC"]


def test_two_companions_of_one_name_are_both_seen_and_say_so(net):
    make_vehicle, make_desk = net
    desk, one = make_desk(), make_vehicle()
    two = make_vehicle(folder="impostor")
    for life in (one.port.member.instance_id, two.port.member.instance_id):
        desk.until(alive(life, True))
    desk.until(
        lambda h: (
            h
            if isinstance(h, EventsReceived) and "another instance of d1" in h.events[0].text
            else None
        )
    )


def answer_to_bytes(config: Path, payload: bytes) -> bytes:
    """Return d1's reply to a stranger that sends these bytes as a command."""
    key, limit_s = f"leeway/{FLEET}/vehicle/d1/command", monotonic_s() + PATIENCE_S
    with zenoh.open(zenoh.Config.from_file(str(config))) as stranger:
        while monotonic_s() < limit_s:
            for reply in stranger.get(key, payload=payload, timeout=1.0):
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
    raise AssertionError(f"not answered within {PATIENCE_S} s")


def test_bytes_that_are_no_message_are_said_and_break_neither_end(net, tmp_path):
    make_vehicle, make_desk = net
    desk, vehicle = make_desk(), make_vehicle()
    desk.state()
    vehicle.port.member.link.publish_state(b'{"v": 9}')
    said = desk.until(lambda h: h if isinstance(h, MessageRejected) else None)
    assert "version 9, expected 2" in said.reason
    assert b'"refused"' in answer_to_bytes(tmp_path / "vehicle.json5", b"\xff" * 100)
    assert desk.response(a_command(vehicle, Recall())).result.status is CommandStatus.DONE


def test_a_companion_without_a_network_waits_for_nobody(tmp_path):
    nowhere = config_file(tmp_path / "v.json5", connect=free_port())
    vehicle = Vehicle("d1", tmp_path / "d1", nowhere)
    for n in range(50):
        vehicle.port.record_event(EventKind.TEXT, f"words {n}")
    assert vehicle.port.member.log.last_stored_seq == 50
    vehicle.close()


def test_vehicles_hear_where_their_neighbours_are_and_nothing_of_themselves(tmp_path):
    port = free_port()
    one = Vehicle("d1", tmp_path / "1", config_file(tmp_path / "1.json5", listen=port))
    two = Vehicle("d2", tmp_path / "2", config_file(tmp_path / "2.json5", connect=port))
    place = PublishTrack(
        1.8e9, **HERE, alt_amsl_m=50.0, vel_ned_mps=(1.0, 2.0, 0.0), on_setpoints=True
    )
    heard: list[Any] = []
    limit_s = monotonic_s() + PATIENCE_S
    try:
        while not heard and monotonic_s() < limit_s:
            two.port.report_action_to_desk(place)
            one.woken.wait(0.05)
            heard = one.port.take_received_tracks(5.0)
        first = heard[0]
        assert (first.t_s, first.track.vehicle, first.track.vel_e_mps) == (5.0, "d2", 2.0)
        assert two.port.take_received_tracks(5.0) == []
    finally:
        one.close()
        two.close()


def test_a_covariance_is_told_while_all_who_ask_for_states_read_it(net, tmp_path: Path):
    make_vehicle, make_desk = net
    vehicle, desk = make_vehicle(), make_desk()
    assert not vehicle.port.member.link.do_all_clients_read_wind_cov()  # no request so far
    desk.until(alive(vehicle.port.member.instance_id, True))
    desk.fleet.request_states(2.0)
    desk.state()
    assert vehicle.port.member.link.do_all_clients_read_wind_cov()
    limit_s = monotonic_s() + PATIENCE_S
    with zenoh.open(read_and_check_zenoh_config(tmp_path / "vehicle.json5")) as before:
        while vehicle.port.member.link.do_all_clients_read_wind_cov():
            before.get(VehicleKeys(FLEET, "*").state_key, lambda reply: None, timeout=2.0)
            assert monotonic_s() < limit_s, "a desk of before has asked"
            desk.fleet.receive(0.1)


def test_a_desk_that_starts_before_its_router_waits_for_it(tmp_path, capfd):
    port = free_port()
    config = config_file(tmp_path / "desk.json5", connect=port, mode="client")
    opened: list[Desk] = []
    waiting = threading.Thread(target=lambda: opened.append(Desk(config)), daemon=True)
    waiting.start()
    waiting.join(2.5)
    assert not opened, "no router yet"
    router = zenoh.open(
        read_and_check_zenoh_config(config_file(tmp_path / "r.json5", listen=port, mode="router"))
    )
    try:
        waiting.join(PATIENCE_S)
        assert len(opened) == 1
        assert "router not reached, trying again" in capfd.readouterr().err
        opened[0].fleet.close()
    finally:
        router.close()
