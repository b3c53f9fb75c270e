"""Recalls: through the companion, or straight to an autopilot whose companion is silent."""

import secrets

from companion.core.base.errors import LeewayError
from companion.fleet.messages import Answered, Recall
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.direct_line import return_to_launch
from ground_station.app.desk.exchange import Exchange
from ground_station.core.fleet.truck_state import TRUCK

LISTEN_S = 0.2
JOIN_S = 2.0
"""How long the fleet is listened for before it counts who is there."""


class NobodyHeardError(LeewayError):
    """A recall of all found no vehicle to recall."""


def recall(exchange: Exchange, vehicle: str | None, wait_s: float) -> set[str]:
    """Recall one vehicle, or (None) all that are heard; the names of those that did not take it.

    Raises NobodyHeardError where all are asked and none is heard.
    """
    store, status = exchange.store, exchange.status
    heard_until_s = monotonic_s() + min(wait_s, JOIN_S)
    while monotonic_s() < heard_until_s and (vehicle is None or not _is_heard(exchange, vehicle)):
        exchange.listen(LISTEN_S)
    heard = {name for name in status.vehicles if _is_heard(exchange, name)}
    names = {vehicle} if vehicle else heard
    if not names:
        raise NobodyHeardError(f"no vehicle was heard in {min(wait_s, JOIN_S):g} s: none recalled")
    asked = {f"recall-{name}-{secrets.token_hex(6)}": name for name in names}
    for id_, name in asked.items():
        store.command(id_, name, Recall(), "operator")
    until_s = monotonic_s() + wait_s
    waiting = set(asked)
    while waiting and monotonic_s() < until_s:
        exchange.listen(LISTEN_S)
        exchange.send_outbox(only=waiting)
        waiting &= {row.id for row in store.outbox()}
    for id_ in waiting:
        store.give_up(id_, "not answered in time")  # it must not be sent later, as a surprise
    answers = store.answers(list(asked))
    return {name for id_, name in asked.items() if answers.get(id_) is not Answered.DONE}


def _is_heard(exchange: Exchange, vehicle: str) -> bool:
    seen = exchange.status.of(vehicle)
    return seen.state is not None and bool(seen.lives) and vehicle != TRUCK


def recall_past_companion(
    exchange: Exchange, vehicle: str, url: str, silent_for_s: float
) -> set[str]:
    """Return to launch over MAVSDK, once the companion has been silent for this time.

    The vehicle, or nothing where its companion is not silent: then that recalls it, or nobody.
    """
    exchange.say(f"{vehicle}: listening {silent_for_s:.0f} s for its companion first")
    begin_s = monotonic_s()
    while monotonic_s() - begin_s < silent_for_s:
        exchange.listen(LISTEN_S)
        seen = exchange.status.of(vehicle)
        if seen.lives or (seen.heard_s is not None and seen.heard_s > begin_s):
            exchange.say(f"{vehicle}: its companion lives: recalled by it, or not at all")
            return set()
    done = return_to_launch(url)
    exchange.say(f"{vehicle}: autopilot {done.system} returns to launch, told past its companion")
    return {vehicle}
