"""A relay between two zenoh networks that loses messages: the fleet's on one side, the desk's on
the other.

Neither side knows: states, events, commands, questions and answers are passed on, or not. An
answer is passed on whole or not at all, as `sim_bridge.app.day.bus` has it. Liveliness always gets
through.
"""

import threading
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from companion.fleet.topics import VehicleKeys

QUESTION_S = 5.0
"""How long an answer of a vehicle is waited for: no longer than the desk waits."""

UNANSWERED = 512
"""Questions kept open after they were lost, so that who asks learns it by waiting; the desk asks a
few a second and waits seconds."""


@dataclass(slots=True)
class Dice:
    """What gets through. Asked by zenoh's threads, so one at a time."""

    rng: np.random.Generator
    loss: float
    sent: int = 0
    lost: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def loses(self) -> bool:
        """Whether the next message is lost."""
        with self._lock:
            self.sent += 1
            lost = self.rng.random() < self.loss
            self.lost += lost
            return lost


class LossyRelay:
    """Passes a fleet's messages between `members` and `desk`, each a network of its own."""

    def __init__(self, fleet: str, members: zenoh.Config, desk: zenoh.Config, dice: Dice) -> None:
        self._dice = dice
        self._members = zenoh.open(members)
        self._desk = zenoh.open(desk)
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._unanswered: deque[zenoh.Query] = deque(maxlen=UNANSWERED)
        keys = VehicleKeys(fleet, "*")
        questions = (keys.command, keys.event, keys.state)
        self._held: tuple[Any, ...] = (  # a declaration that nobody holds is undeclared
            self._members.declare_subscriber(keys.state, self._publish),
            self._members.declare_subscriber(keys.event, self._publish),
            self._members.liveliness().declare_subscriber(
                keys.alive(), self._see_alive, history=True
            ),
            *(self._desk.declare_queryable(key, self._ask) for key in questions),
        )

    def close(self) -> None:
        """Leave both networks."""
        self._unanswered.clear()
        self._held = ()
        self._desk.close()
        self._members.close()

    def _publish(self, sample: zenoh.Sample) -> None:
        if not self._dice.loses():
            self._desk.put(sample.key_expr, sample.payload, express=True)

    def _see_alive(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        token = self._tokens.pop(key, None)
        if sample.kind == zenoh.SampleKind.PUT:
            self._tokens[key] = token or self._desk.liveliness().declare_token(key)
        elif token is not None:
            token.undeclare()

    def _ask(self, query: zenoh.Query) -> None:
        if self._dice.loses():
            self._unanswered.append(query)
            return
        answers: list[tuple[zenoh.KeyExpr, zenoh.ZBytes]] = []

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                answers.append((reply.ok.key_expr, reply.ok.payload))

        def done() -> None:
            if not answers or self._dice.loses():
                self._unanswered.append(query)
                return
            for key, payload in answers:
                query.reply(key, payload)
            query.drop()

        self._members.get(
            query.selector,
            zenoh.handlers.Callback(take, done),
            payload=query.payload,
            timeout=QUESTION_S,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            express=True,
        )
