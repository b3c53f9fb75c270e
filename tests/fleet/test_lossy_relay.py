"""The relay that loses fleet messages between processes: real zenoh on loopback."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.fleet.messages import Answered, Command, Recall
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    FleetInput,
    LivelinessChanged,
    StateReceived,
)
from sim_bridge.app.day.processes import DESK, MEMBER, ZenohNetwork
from tests.fleet.zenoh_net import FLEET, Vehicle

PATIENCE_S = 20.0


@pytest.fixture
def net(tmp_path: Path) -> Iterator[Callable[[float], tuple[Vehicle, ZenohFleet, ZenohNetwork]]]:
    """A vehicle and a desk with a relay between them that loses so much."""
    opened: list[Vehicle | ZenohNetwork | ZenohFleet] = []

    def start(loss: float) -> tuple[Vehicle, ZenohFleet, ZenohNetwork]:
        network = ZenohNetwork.open(tmp_path, FLEET, loss, np.random.default_rng(4))
        opened.append(network)
        vehicle = Vehicle("d1", tmp_path / "d1", tmp_path / MEMBER)
        opened.append(vehicle)
        desk = ZenohFleet(FLEET, tmp_path / DESK)
        opened.append(desk)
        return vehicle, desk, network

    yield start
    for one in reversed(opened):
        one.close()


def until(desk: ZenohFleet, there: Callable[[list[FleetInput]], bool]) -> list[FleetInput]:
    found: list[FleetInput] = []
    end_s = time.monotonic() + PATIENCE_S
    while not there(found):
        assert time.monotonic() < end_s, found[-5:]
        found += desk.receive(0.1)
    return found


def recall(desk: ZenohFleet, id_: str, states: list[FleetInput], wait_s: float) -> None:
    state = next(h.state for h in reversed(states) if isinstance(h, StateReceived))
    command = Command(
        id=id_, vehicle="d1", life=state.life, as_of_s=state.uptime_s, by="desk", deed=Recall()
    )
    desk.send(command, wait_s)


def is_state(heard: FleetInput) -> bool:
    return isinstance(heard, StateReceived)


def test_without_loss_states_liveliness_and_answers_come_through(net):
    """Without a relay, as with one: the world that listens in hears what the desk hears."""
    vehicle, desk, network = net(0.0)
    heard = until(
        desk, lambda h: any(map(is_state, h)) and any(isinstance(x, LivelinessChanged) for x in h)
    )
    recall(desk, "c1", heard, 5.0)
    (answer,) = (
        h
        for h in until(desk, lambda h: any(isinstance(x, CommandAnswered) for x in h))
        if isinstance(h, CommandAnswered)
    )
    assert answer.result is not None
    assert answer.result.answer is Answered.DONE
    assert [command.id for command in vehicle.done] == ["c1"]
    network.deliver(0.0)
    assert set(network.states) == {"d1"}  # the judge of promises lives on it
    assert network.lost == 0
    vehicle.close()
    until(desk, lambda h: LivelinessChanged("d1", vehicle.port.life, up=False) in h)


def test_what_is_lost_is_not_answered_and_what_is_sent_again_is_carried_out_once(net):
    vehicle, desk, network = net(0.5)
    heard = until(desk, lambda h: sum(map(is_state, h)) > 0)
    answered = missed = 0
    while not (answered and missed > 1):
        recall(desk, "c1", heard, 0.3)
        found = until(desk, lambda h: any(isinstance(x, CommandAnswered) for x in h))
        result = next(h.result for h in found if isinstance(h, CommandAnswered))
        answered, missed = answered + (result is not None), missed + (result is None)
    assert [command.id for command in vehicle.done] == ["c1"]
    network.deliver(0.0)
    assert set(network.states) == {"d1"}
    # binomial: further than four standard deviations from a half one time in 16,000
    assert abs(network.lost - network.sent / 2.0) < 4.0 * np.sqrt(network.sent) / 2.0
