"""kill -9 at any moment: no acknowledged order is lost, none is flown twice."""

import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.fleet.command_log import CommandLog, CommandReply
from companion.fleet.messages import (
    Command,
    CommandAction,
    CommandStatus,
    EventKind,
    FleetEvent,
    Launch,
)
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.schema.orders import OrderState

DESK = Path(__file__).parent / "desk_process.py"
ORDERS, VEHICLES = 8, 3
KILLS = {"sqlite": 4, "postgresql": 2}


class World:
    """Vehicles with a command book each that outlive every desk and repeat all events."""

    def __init__(self) -> None:
        self.database = [CommandLog() for _ in range(VEHICLES)]
        self.flights: Counter[str] = Counter()
        self.told: list[FleetEvent] = []
        self.acknowledged: set[str] = set()

    def answer(self, line: dict[str, Any]) -> dict[str, Any]:
        if "acknowledged" in line:
            self.acknowledged.add(line["acknowledged"])
            return {}
        if "events" in line:
            return {"events": msgspec.to_builtins(self.told)}
        return {"answer": self._take(line).value, "life": "x"}

    def _take(self, line: dict[str, Any]) -> CommandStatus:
        book = self.database[int(line["vehicle"][1:])]
        command = Command(
            id=line["send"],
            vehicle=line["vehicle"],
            instance_id="x",
            as_of_s=1.0,
            by="desk",
            action=msgspec.convert(line["deed"], CommandAction),
        )
        verdict = book.reply_without_execution_or_none(command, "x", 1.0)
        if verdict is None:
            book.record_start(command)
            if isinstance(command.action, Launch):
                self._fly(command.vehicle, command.action.assignment)
            verdict = CommandReply(CommandStatus.DONE)
            book.record_final_reply_or_remove_command(command, verdict)
        return verdict.status

    def _fly(self, vehicle: str, assignment: str) -> None:
        self.flights[assignment.partition(".")[0]] += 1
        self.told.append(
            FleetEvent(
                vehicle=vehicle,
                log="l",
                seq=1 + sum(event.vehicle == vehicle for event in self.told),
                epoch_us=1,
                kind=EventKind.OUTCOME,
                text="",
                assignment=assignment,
                outcome="SUC",
                delivered=True,
                home=True,
            )
        )


def run_desk(url: str, world: World, lines: int | None, wait_s: float) -> bool:
    """Serve a desk until it is done, or kill it after this many lines and this delay."""
    command = [sys.executable, str(DESK), url, str(ORDERS), str(VEHICLES)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as desk:
        assert desk.stdin is not None
        assert desk.stdout is not None
        for heard, text in enumerate(desk.stdout):
            line = json.loads(text)
            if "over" in line:
                return True
            answer = world.answer(line)
            if heard == lines:
                if wait_s > 0.0:  # otherwise the reply is never received
                    desk.stdin.write(json.dumps(answer) + "\n")
                    desk.stdin.flush()
                    time.sleep(wait_s)
                desk.kill()
                desk.stdin.close()
                return False
            desk.stdin.write(json.dumps(answer) + "\n")
            desk.stdin.flush()
    raise AssertionError(f"the desk broke: exit code {desk.returncode}")


@pytest.mark.sample
@pytest.mark.parametrize("seed", [1])
def test_killed_at_random_moments_the_desk_flies_every_acknowledged_order_once(
    store_url: str, seed: int
):
    rng = np.random.default_rng(seed)
    world = World()
    for _ in range(KILLS[store_url.partition(":")[0]]):
        wait_s = 0.0 if rng.random() < 0.4 else float(rng.uniform(0.0, 0.03))
        if run_desk(store_url, world, int(rng.integers(1, 8)), wait_s):
            break
    assert run_desk(store_url, world, None, 0.0)
    store = Store(Database(store_url), lambda: 1)
    delivered = {r.order.id for r in store.orders() if r.state is OrderState.DELIVERED}
    store.close()
    assert delivered >= world.acknowledged
    assert world.flights == {f"o{n}": 1 for n in range(ORDERS)}
