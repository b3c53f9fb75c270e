"""What a person orders, from the terminal or the map: the same steps, and the same audit."""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.settle import SETTLED_FROM
from ground_station.adapters.store.settle import settle as settle_order
from ground_station.app.desk.recall import NobodyHeardError, Recaller
from ground_station.app.desk.recall import recall as recall_fleet
from ground_station.app.desk.recall_record import RecallRecord
from ground_station.core.fleet.fleet_link import FleetLink
from ground_station.core.schema.holds import ALL, check_vehicle, holding
from ground_station.core.schema.order_states import OrderState, Settled

Say = Callable[[str], None]
EpochUs = Callable[[], int]


@dataclass(frozen=True, slots=True)
class Deed:
    """What was done, in words. `look`: what a person has to look at now."""

    words: list[str]
    look: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Recalled:
    """The end of a recall. `missing`: who has not taken it; `nobody`: why none could be asked,
    empty: they were; `held`: the store has hold and audit.
    """

    missing: set[str]
    nobody: str
    held: bool


def hold(store: Store, epoch_us: EpochUs, scopes: list[str], reason: str, by: str) -> Deed:
    """Hold vehicles (or `ALL`) on the ground."""
    sent = HoldStore(store.database, epoch_us).set(scopes, reason, by)
    look = [f"LOOK: the launch of {one} was sent before: it may take off" for one in sent]
    return Deed([found.words for found in store.holds() if found.scope in scopes], look)


def release(store: Store, epoch_us: EpochUs, scopes: list[str], by: str) -> Deed:
    """Lift holds; what is to be looked at: those that were not held by that name."""
    lifted = HoldStore(store.database, epoch_us).release(scopes, by)
    words = [f"released: {found.words}" for found in lifted]
    words += [f"in force: {found.words}" for found in store.holds()]
    free = sorted(set(scopes) - {found.scope for found in lifted})
    return Deed(words, [f"release {' '.join(free)}: not held by that name"] if free else [])


def confirm_launch(store: Store, order_id: str, by: str) -> Deed:
    """Let the drone that has this order be launched. Raises LeewayError with the reason why not."""
    id_ = store.confirm_launch(order_id, by)
    if id_ is None:
        raise LeewayError(f"order {order_id}: {_why_not_launched(store, order_id)}")
    return Deed([f"{id_}: confirmed by {by}; it goes when its slot comes"])


def _why_not_launched(store: Store, order_id: str) -> str:
    rows = (row for row in store.assignments(in_force=True) if row.order_id == order_id)
    row = next(rows, None)
    if row is None:
        return "no drone has it"
    found = holding(store.holds(), row.vehicle)
    return (
        found.words if found is not None else f"{row.state.value} with {row.vehicle}, not waiting"
    )


def settle(
    store: Store, epoch_us: EpochUs, order_id: str, settled: Settled, reason: str, by: str
) -> Deed:
    """Close an order by a person's word. Raises LeewayError where it is in no state for that."""
    done = settle_order(store.database, epoch_us, order_id, settled, reason, by)
    if done is None:
        raise not_in(store, order_id, SETTLED_FROM)
    return Deed([done])


def not_in(store: Store, order_id: str, before: tuple[OrderState, ...]) -> LeewayError:
    """What is wrong with an order that is in none of these states."""
    state = next((r.state.value for r in store.orders() if r.order.id == order_id), None)
    expected = " or ".join(s.value for s in before)
    return LeewayError(f"order {order_id}: {state or 'not known'}, expected {expected}")


def recall(
    fleet: FleetLink,
    open_store: Callable[[], Store],
    vehicle: str | None,
    by: str,
    say: Say,
    look: Say,
    wait_s: float,
    past_companion: Callable[[Recaller, set[str]], set[str]] = lambda caller, missing: set(),
) -> Recalled:
    """Recall a vehicle, or (None) all that are heard, and hold what is recalled.

    `past_companion(caller, missing)` recalls those that it can without their companions, and names
    them. `look` is told what a person has to look at. The store is opened when it can be. Raises
    LeewayError for an impossible name.
    """
    if vehicle is not None:
        check_vehicle(vehicle)
    caller = Recaller(fleet, say, by)
    record = RecallRecord(open_store, by, say, caller.clock)
    missing, nobody = set[str](), ""
    try:
        caller.begin()
        missing = recall_fleet(caller, record, vehicle, wait_s)
        missing -= past_companion(caller, missing)
    except NobodyHeardError as error:
        nobody = str(error)
        look(nobody)
    finally:
        record.close()
        if not record.is_written:
            look(f"NOT HELD, not in the audit: {record.why_not}")
    if missing:
        look(f"not recalled: {', '.join(sorted(missing))}")
    return Recalled(missing, nobody, record.is_written)


def scopes_of(vehicle: str | None) -> list[str]:
    """What a hold of a vehicle, or (None) of all, is of. LeewayError for an impossible name."""
    if vehicle is None:
        return [ALL]
    check_vehicle(vehicle)
    return [vehicle]
