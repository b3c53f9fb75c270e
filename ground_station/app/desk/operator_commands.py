"""Commands of an operator, from the terminal or the map, with the same steps and audit entries."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us as clock_epoch_us
from ground_station.adapters.clock import local_date
from ground_station.adapters.store.audit_steps import MAX_TEXT_LENGTH
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.orders import order_changes, out_of_service
from ground_station.adapters.store.orders.order_history import delivery_proofs, record_photo
from ground_station.adapters.store.settle import SETTLED_FROM
from ground_station.adapters.store.settle import (
    close_order_with_outcome as close_order_with_outcome,
)
from ground_station.adapters.store.shift import days
from ground_station.adapters.store.shift.pack_store import fit_pack
from ground_station.app.desk.recall import NoVehicleReceivedError, Recaller
from ground_station.app.desk.recall import recall_and_hold_vehicles as recall_fleet
from ground_station.app.desk.recall_record import RecallRecord
from ground_station.core.fleet.fleet_link import FleetLink
from ground_station.core.schema.day_data import DayData, data_with_spares
from ground_station.core.schema.holds import (
    ALL_DRONES,
    hold_of_vehicle_or_of_all,
    raise_if_invalid_vehicle_name,
)
from ground_station.core.schema.order_changes import order_cells
from ground_station.core.schema.order_parsing import order_from_cells
from ground_station.core.schema.order_states import OrderState, ParcelOutcome
from ground_station.core.schema.orders import Order

LogMessage = Callable[[str], None]
EpochUs = Callable[[], int]
WINDOW_ENDS = ("window_from", "window_to")


@dataclass(frozen=True, slots=True)
class CommandReport:
    """Result of a command as text. `checks`: items that the operator has to check now."""

    messages: list[str]
    checks: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class RecallResult:
    """Result of a recall. `not_recalled`: vehicles that did not accept it; `no_vehicle_reason`:
    reason why no vehicle was reached, else empty; `is_recorded`: hold and audit entry are in the
    store.
    """

    not_recalled: set[str]
    no_vehicle_reason: str
    is_recorded: bool


def place_holds(
    store: Store, epoch_us: EpochUs, scopes: list[str], reason: str, by: str
) -> CommandReport:
    """Hold vehicles (or `ALL_DRONES`) on the ground."""
    sent_launches = HoldStore(store.database, epoch_us).place_holds(scopes, reason, by)
    checks = [
        f"WARNING: {one} may take off, launch already sent: keep pad clear" for one in sent_launches
    ]
    return CommandReport(
        [found.text for found in store.holds_in_force() if found.scope in scopes], checks
    )


def take_out_of_service(
    store: Store, epoch_us: EpochUs, vehicle: str, reason: str, by: str, spare: str | None
) -> CommandReport:
    """Hold a drone and give its order on the ground to another one. `spare`: joins in its place.
    LeewayError for an invalid name.
    """
    done = out_of_service.take_out_of_service(store.database, epoch_us, vehicle, reason, by, spare)
    return CommandReport(done)


def clear_holds(store: Store, epoch_us: EpochUs, scopes: list[str], by: str) -> CommandReport:
    """Release holds; `report_operator_check` of the result names scopes that had no such hold."""
    released = HoldStore(store.database, epoch_us).clear_holds(scopes, by)
    messages = [f"released: {h.subject} (was held by {h.by}: {h.reason})" for h in released]
    messages += [f"in force: {found.text}" for found in store.holds_in_force()]
    free = sorted(set(scopes) - {found.scope for found in released})
    names = ("every drone" if scope == ALL_DRONES else scope for scope in free)
    return CommandReport(messages, [f"{name}: no launch hold of its own" for name in names])


def record_launch_confirmation(
    store: Store,
    order_id: str,
    by: str,
    epoch_us: EpochUs = clock_epoch_us,
    pack: str | None = None,
) -> CommandReport:
    """Confirm the launch of the drone with this order. LeewayError gives the reason if refused.
    `pack`: fitted to the drone.
    """
    checks: list[str] = []
    if pack is not None:
        in_force = store.assignments(in_force=True)
        vehicle = next((row.vehicle for row in in_force if row.order_id == order_id), None)
        if vehicle is None:
            raise LeewayError(f"order {order_id}: {_launch_refusal_reason(store, order_id)}")
        checks = fit_pack(store.database, epoch_us, vehicle, pack, by)
    id_ = store.record_launch_confirmation(order_id, by)
    if id_ is None:
        raise LeewayError(f"order {order_id}: {_launch_refusal_reason(store, order_id)}")
    text = "it launches when the gap after the last launch permits"
    return CommandReport([f"{order_id}: launch confirmed by {by}; {text}"], checks)


def _launch_refusal_reason(store: Store, order_id: str) -> str:
    rows = (row for row in store.assignments(in_force=True) if row.order_id == order_id)
    row = next(rows, None)
    if row is None:
        return "no drone is assigned"
    found = hold_of_vehicle_or_of_all(store.holds_in_force(), row.vehicle)
    return found.text if found is not None else f"{row.state.value} with {row.vehicle}, not waiting"


def close_order_as_operator(
    store: Store,
    epoch_us: EpochUs,
    order_id: str,
    parcel_outcome: ParcelOutcome,
    reason: str,
    by: str,
) -> CommandReport:
    """Close an order on the operator's decision. LeewayError if its state does not permit it."""
    result_text = close_order_with_outcome(
        store.database, epoch_us, order_id, parcel_outcome, reason, by
    )
    if result_text is None:
        raise order_state_error(store, order_id, SETTLED_FROM)
    return CommandReport([result_text])


def add_orders(store: Store, orders: list[Order], by: str) -> CommandReport:
    """Add orders, or none. LeewayError if one is stored with other content."""
    result = store.add_orders_unless_conflict(orders, by)
    if result.conflicts:
        text = ", ".join(result.conflicts)
        raise LeewayError(f"orders {text}: already stored with other content; nothing imported")
    if result.earlier:
        text = ", ".join(result.earlier)
        raise LeewayError(f"orders {text}: of an earlier day, expected new ids; nothing imported")
    known = f", {len(result.known)} imported before" if result.known else ""
    if result.kept:
        known += f", of them {', '.join(result.kept)} changed since by a person: kept as changed"
    return CommandReport([f"{len(result.added)} orders imported{known}"])


def cancel_order(
    store: Store,
    epoch_us: EpochUs,
    order_id: str,
    by: str,
    reason: str,
    *,
    to_sender: bool = False,
) -> CommandReport:
    """Cancel an order, or return it to its sender; withdraws it on the ground. LeewayError if its
    state does not permit it.
    """
    state = OrderState.RETURNED if to_sender else OrderState.CANCELLED
    text = order_changes.cancel_order(store.database, epoch_us, order_id, by, reason, state)
    return CommandReport([text])


def change_order(
    store: Store,
    epoch_us: EpochUs,
    order_id: str,
    cells: Mapping[str, str],
    by: str,
    data: DayData | None = None,
) -> CommandReport:
    """Change the fields of an order that `cells` has, as columns of an order file. LeewayError if
    a cell is wrong, or the order's state does not permit it. `data`: the day, for ground heights.
    """

    def changed_order(order: Order) -> Order:
        moves = {"lat_deg", "lon_deg"} & cells.keys()
        height = {"alt_amsl_m": ""} if moves and "alt_amsl_m" not in cells else {}
        before = order_cells(order)
        window: dict[str, str] = {}
        if set(WINDOW_ENDS) & cells.keys():  # one may change without the other
            window = {
                **dict(zip(WINDOW_ENDS, before["window"].split("/"), strict=False)),
                "window": "",
            }
        depot, elevation = (None, None) if data is None else (data.day.depot, data.elevation)
        all_cells = {**before, **height, **window, **cells}
        return order_from_cells(all_cells, depot, elevation, local_date())

    text = order_changes.change_order(store.database, epoch_us, order_id, changed_order, by)
    return CommandReport([text])


def add_photo(
    store: Store, epoch_us: EpochUs, order_id: str, photo: Path, by: str
) -> CommandReport:
    """Record a photo of a delivery. LeewayError: no such file, or the order is not delivered."""
    path = photo.resolve()
    if order_id not in delivery_proofs(store.database, order_id):
        raise LeewayError(f"order {order_id}: no delivery to prove, expected a delivered order")
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise LeewayError(f"{photo}: {error.strerror}") from error
    text = f"photo {path} (SHA-256 {digest})"
    if len(text) > MAX_TEXT_LENGTH:
        raise LeewayError(f"{photo}: path too long, expected at most 400 characters")
    record_photo(store.database, epoch_us(), order_id, text, by)
    return CommandReport([f"{order_id}: {text}"])


def order_state_error(
    store: Store, order_id: str, expected_states: tuple[OrderState, ...]
) -> LeewayError:
    """Return the error for an order that is in none of the expected states."""
    state = next((r.state.value for r in store.orders() if r.order.id == order_id), None)
    expected = " or ".join(s.value for s in expected_states)
    return LeewayError(f"order {order_id}: {state or 'not known'}, expected {expected}")


def recall_hold_and_record(
    fleet: FleetLink,
    open_store: Callable[[], Store],
    vehicle: str | None,
    by: str,
    log: LogMessage,
    report_operator_check: LogMessage,
    wait_s: float,
    recall_with_autopilot: Callable[[Recaller, set[str]], set[str]] = lambda recaller, missing: (
        set()
    ),
) -> RecallResult:
    """Recall a vehicle, or (None) all received vehicles, and hold them.

    `recall_with_autopilot(recaller, missing)` recalls vehicles without their companions and returns
    their names. `report_operator_check` receives the items that the operator has to check. The
    store is opened as soon as it is reachable. Raises LeewayError for an invalid name.
    """
    if vehicle is not None:
        raise_if_invalid_vehicle_name(vehicle)
    recaller = Recaller(fleet, log, by)
    record = RecallRecord(open_store, by, log, recaller.clock)
    missing, no_vehicle_reason = set[str](), ""
    try:
        recaller.request_states()
        missing = recall_fleet(recaller, record, vehicle, wait_s)
        missing -= recall_with_autopilot(recaller, missing)
    except NoVehicleReceivedError as error:
        no_vehicle_reason = str(error)
        report_operator_check(no_vehicle_reason)
    finally:
        record.close()
        if not record.is_hold_placed_and_commands_stored:
            remedy = f"run ground-station hold {vehicle or '--all'} --reason recalled"
            report_operator_check(f"launch hold not stored ({record.store_error}): {remedy}")
    if missing:
        remedy = "recall again, use recall --direct, or command RTL by RC"
        report_operator_check(f"{', '.join(sorted(missing))} did not accept the recall: {remedy}")
    return RecallResult(missing, no_vehicle_reason, record.is_hold_placed_and_commands_stored)


def hold_scopes_of(vehicle: str | None) -> list[str]:
    """Return the scopes of a hold on a vehicle, or (None) on all. LeewayError: invalid name."""
    if vehicle is None:
        return [ALL_DRONES]
    raise_if_invalid_vehicle_name(vehicle)
    return [vehicle]


def data_with_stored_spares(data: DayData, store: Store) -> DayData:
    """Return the data of a day with the spare drones that have joined it."""
    return data_with_spares(data, days.read_spares(store.database))


def begin_or_continue_day(store: Store, by: str, *, new_day: bool) -> str:
    """Begin today's day if asked; return the result, or a warning for an older day; else empty."""
    today, day = local_date().isoformat(), days.current_day(store.database)
    if new_day:
        return days.begin_day(store.database, clock_epoch_us, today, by)
    text = f"WARNING: day {day} of the store continues; --new-day begins {today}"
    return "" if day == today else text
