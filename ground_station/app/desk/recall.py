"""Recalls: through the companion, or straight to an autopilot whose companion is silent.

A recall needs no store: it is sent first, and written as soon as the store can be reached. Written,
it is also a hold: what was recalled is not launched again before a person releases it.
"""

import secrets
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.core.base.errors import LeewayError
from companion.fleet.messages import FINAL, Answered, Command, Recall
from ground_station.adapters.clock import WallClock
from ground_station.adapters.direct_line import return_to_launch
from ground_station.app.desk.exchange import ANSWER_S, RETRY_S
from ground_station.app.desk.recall_record import RecallRecord
from ground_station.core.fleet.fleet_link import (
    Clock,
    CommandAnswered,
    FleetInput,
    FleetLink,
    LivelinessChanged,
    StateReceived,
)
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.holds import ALL

LISTEN_S = 0.2
JOIN_S = 2.0
"""How long the fleet is listened for before it counts who is there."""

SAY_S = 0.5
"""After so long somebody who waits is told that nobody was heard: within a second. Members that are
there have answered by then; on one machine programs call each other twice a second.
"""


class NobodyHeardError(LeewayError):
    """A recall of all found no vehicle to recall."""


@dataclass(slots=True)
class Recaller:
    """Listens to the fleet and recalls; `by`: the person who does."""

    fleet: FleetLink
    say: Callable[[str], None]
    by: str
    clock: Clock = field(default_factory=WallClock)
    status: FleetStatus = field(default_factory=FleetStatus)
    answers: dict[str, Answered] = field(default_factory=dict)
    _sent_s: dict[str, float] = field(default_factory=dict)

    def begin(self) -> None:
        """Ask for the state of the whole fleet."""
        self.fleet.ask_states(ANSWER_S)

    def listen(self, wait_s: float = LISTEN_S) -> None:
        """Take what has come, waiting this long for the first."""
        for received in self.fleet.receive(wait_s):
            self._take(received)

    def _take(self, received: FleetInput) -> None:
        match received:
            case LivelinessChanged():
                self.status.on_liveliness(received.vehicle, received.life, up=received.up)
                if received.up:
                    self.fleet.ask_states(ANSWER_S)
            case StateReceived():
                now_s, now_us = self.clock.monotonic_s(), self.clock.epoch_us()
                self.status.on_state(received.state, now_s, now_us)
            case CommandAnswered() if received.result is not None:
                self._take_answer(received.command_id, received.result.answer)
                words = f"{received.result.answer.value} {received.result.reason}"
                self.say(f"{received.result.vehicle}: {received.command_id}: {words}")
            case _:
                return

    def _take_answer(self, id_: str, answer: Answered) -> None:
        if answer in FINAL:
            self.answers[id_] = answer

    def heard(self) -> set[str]:
        """The drones that are heard."""
        return {name for name in self.status.vehicles if self.hears(name)}

    def hears(self, vehicle: str) -> bool:
        """Whether a drone has told its state and is on the network."""
        seen = self.status.of(vehicle)
        return seen.state is not None and bool(seen.lives) and vehicle != TRUCK

    def join(self, vehicle: str | None, wait_s: float) -> None:
        """Listen until the vehicle, or (None) whoever is there, is heard; say where nobody is."""
        began_s, said = self.clock.monotonic_s(), False
        while self.clock.monotonic_s() - began_s < min(wait_s, JOIN_S):
            if vehicle is not None and self.hears(vehicle):
                return
            self.listen()
            if self.clock.monotonic_s() - began_s > SAY_S and not said:
                said = self._say_silence(vehicle)

    def _say_silence(self, vehicle: str | None) -> bool:
        heard = ", ".join(sorted(self.heard()))
        if heard and vehicle is None:
            return False
        self.say(f"{vehicle or 'nobody'}: not heard yet; heard: {heard or 'no vehicle'}")
        return True

    def send(self, id_: str, vehicle: str) -> None:
        """Send a recall that is not answered; a silent vehicle's as soon as it is heard."""
        state, now_s = self.status.of(vehicle).state, self.clock.monotonic_s()
        sent_s = self._sent_s.get(id_)
        if state is None or id_ in self.answers:
            return
        if sent_s is not None and now_s - sent_s < RETRY_S:
            return
        self._sent_s[id_] = now_s
        command = Command(
            id=id_,
            vehicle=vehicle,
            life=state.life,
            as_of_s=state.uptime_s,
            by=self.by,
            deed=Recall(),
        )
        self.fleet.send(command, ANSWER_S)


def recall(caller: Recaller, record: RecallRecord, vehicle: str | None, wait_s: float) -> set[str]:
    """Recall one vehicle, or (None) all that are heard; the names of those that did not take it.

    What is recalled is held; with None every drone is, heard or not. Raises NobodyHeardError
    where all are asked and none is heard.
    """
    caller.join(vehicle, wait_s)
    names = {vehicle} if vehicle else caller.heard()
    asked = {f"recall-{name}-{secrets.token_hex(6)}": name for name in sorted(names)}
    for id_, name in asked.items():
        caller.send(id_, name)
    record.begin(ALL if vehicle is None else vehicle, asked)
    until_s = caller.clock.monotonic_s() + wait_s
    while _waits(caller, record, asked) and caller.clock.monotonic_s() < until_s:
        caller.listen()
        for id_, name in asked.items():
            caller.send(id_, name)
        record.end(caller.answers)
    record.give_up()  # it must not be sent later, as a surprise
    if not names:
        raise NobodyHeardError(f"no vehicle was heard in {min(wait_s, JOIN_S):g} s: none recalled")
    return {name for id_, name in asked.items() if caller.answers.get(id_) is not Answered.DONE}


def _waits(caller: Recaller, record: RecallRecord, asked: dict[str, str]) -> bool:
    return not record.is_written or any(id_ not in caller.answers for id_ in asked)


def recall_past_companion(
    caller: Recaller, vehicle: str, url: str, silent_for_s: float
) -> set[str]:
    """Return to launch over MAVSDK, once the companion has been silent for this time.

    The vehicle, or nothing where its companion is not silent: then that recalls it, or nobody.
    """
    caller.say(f"{vehicle}: listening {silent_for_s:.0f} s for its companion first")
    begin_s = caller.clock.monotonic_s()
    while caller.clock.monotonic_s() - begin_s < silent_for_s:
        caller.listen()
        seen = caller.status.of(vehicle)
        if seen.lives or (seen.heard_s is not None and seen.heard_s > begin_s):
            caller.say(f"{vehicle}: its companion lives: recalled by it, or not at all")
            return set()
    done = return_to_launch(url)
    caller.say(f"{vehicle}: autopilot {done.system} returns to launch, told past its companion")
    return {vehicle}
