"""Executes operator commands from the map: opens store and network for each command."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us, local_date
from ground_station.adapters.files.order_files import read_orders
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.shift.handover import accept_handover, hand_over
from ground_station.app.desk import operator_commands
from ground_station.app.desk.operator_commands import CommandReport
from ground_station.core.dispatch.depot_assignment import assigner_of_day
from ground_station.core.feasibility.reach import Feasible
from ground_station.core.fleet.fleet_link import FleetLink
from ground_station.core.people.map_command_messages import (
    AcceptHandover,
    AddOrder,
    CancelOrder,
    ChangeOrder,
    ConfirmLaunch,
    HandOver,
    HoldDrone,
    ImportOrders,
    RecallDrone,
    ReleaseDrone,
    SettleOrder,
    ShiftCommand,
    WebCommand,
)
from ground_station.core.people.person import DeskOperator
from ground_station.core.people.web_tokens import command_refusal_reason
from ground_station.core.schema.day import Depot
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.order_parsing import order_from_cells
from ground_station.core.schema.order_states import ParcelOutcome
from ground_station.core.schema.orders import Order, Service

RECALL_TIMEOUT_S = 10.0
"""Response timeout of a recall, equal to the terminal's."""


@dataclass(frozen=True, slots=True)
class OperatorCommands:
    """`audit_identity(operator)` returns the operator named in the audit; may refuse with
    LeewayError.

    `open_reachable_store` opens a reachable store, or raises StoreError without a long wait.
    """

    audit_identity: Callable[[DeskOperator], DeskOperator]
    open_store: Callable[[], Store]
    open_reachable_store: Callable[[], Store]
    open_fleet: Callable[[], FleetLink]
    data: DayData | None = None
    """The day, for the check of new orders."""

    def execute_command(self, operator: DeskOperator, command: WebCommand) -> dict[str, Any]:
        """Execute a command; return its result and the items to check. Raises LeewayError."""
        refusal = command_refusal_reason(operator)
        if refusal:
            raise LeewayError(refusal)
        issuer = self.audit_identity(operator).name
        match command:
            case RecallDrone():
                report = self._recall(command, issuer)
            case AddOrder() | ImportOrders():
                report = self._add_orders(command, issuer)
            case _:
                report = self._execute_store_command(command, issuer)
        return {"messages": report.messages, "checks": report.checks}

    def _recall(self, command: RecallDrone, issuer: str) -> CommandReport:
        messages, checks = list[str](), list[str]()
        with closing(self.open_fleet()) as fleet:
            operator_commands.recall_hold_and_record(
                fleet,
                self.open_reachable_store,
                command.vehicle,
                issuer,
                messages.append,
                checks.append,
                RECALL_TIMEOUT_S,
            )
        return CommandReport(messages, checks)

    def _add_orders(self, command: AddOrder | ImportOrders, issuer: str) -> CommandReport:
        """Check orders against the day, and add them unless `check`."""
        if isinstance(command, AddOrder):
            orders = [self._order_of_cells(command.cells)]
        else:
            orders = self._orders_of_file(command)
        verdicts = [verdict for order in orders if (verdict := self._verdict(order))]
        can = [text for text, is_feasible in verdicts if is_feasible]
        cannot = [text for text, is_feasible in verdicts if not is_feasible]
        if command.check:
            count = [] if isinstance(command, AddOrder) else [f"{len(orders)} orders can be added"]
            return CommandReport([*count, *can], cannot)
        with closing(self.open_store()) as store:
            added = operator_commands.add_orders(store, orders, issuer)
        return CommandReport([*added.messages, *can], cannot)

    def _order_of_cells(self, cells: dict[str, str]) -> Order:
        elevation = None if self.data is None else self.data.elevation
        return order_from_cells(cells, self._depot, elevation, local_date())

    def _orders_of_file(self, command: ImportOrders) -> list[Order]:
        with TemporaryDirectory(prefix="leeway-orders-") as folder:
            path = Path(folder) / command.file
            path.write_bytes(command.content)
            columns = None if self.data is None else self.data.day.columns
            try:
                return read_orders(path, self._depot, columns)[0]
            except LeewayError as error:
                raise LeewayError(str(error).replace(f"{folder}/", "")) from error

    @property
    def _depot(self) -> Depot | None:
        return None if self.data is None else self.data.day.depot

    def _verdict(self, order: Order) -> tuple[str, bool] | None:
        """Return whether a drone can deliver an order from the depot; None: not known."""
        if self.data is None or order.service is Service.TRUCK:
            return None
        assigner = assigner_of_day(self.data, self.data.elevation)
        infeasible = assigner.infeasibility_for_all_drones(order)
        if infeasible is not None:
            text = f"{order.id}: cannot be flown from the depot: {infeasible.reason}."
            return f"{text} Possible with {infeasible.remedy}.", False
        checks = [(assigner.check_delivery(order, d.id), d.id) for d in self.data.day.drones]
        best = max(
            ((one, name) for one, name in checks if isinstance(one, Feasible)),
            key=lambda found: found[0].spare_wh,
        )
        spare_wh, minutes = best[0].spare_wh, best[0].time_s / 60.0
        return (
            f"{order.id}: can be flown from the depot, by {best[1]} in {minutes:.0f} min with"
            f" {spare_wh:.0f} Wh to spare.",
            True,
        )

    def _execute_store_command(
        self,
        command: HoldDrone
        | ReleaseDrone
        | ConfirmLaunch
        | SettleOrder
        | ChangeOrder
        | CancelOrder
        | ShiftCommand,
        issuer: str,
    ) -> CommandReport:
        with closing(self.open_store()) as store:
            match command:
                case HoldDrone(vehicle=str(vehicle), is_out=True):
                    return operator_commands.take_out_of_service(
                        store, epoch_us, vehicle, command.reason, issuer, command.spare
                    )
                case HoldDrone(is_out=True) | HoldDrone(spare=str()):
                    raise LeewayError("expected a vehicle with out_of_service, and it with spare")
                case HoldDrone():
                    scopes = operator_commands.hold_scopes_of(command.vehicle)
                    return operator_commands.place_holds(
                        store, epoch_us, scopes, command.reason, issuer
                    )
                case ReleaseDrone():
                    scopes = operator_commands.hold_scopes_of(command.vehicle)
                    return operator_commands.clear_holds(store, epoch_us, scopes, issuer)
                case ConfirmLaunch():
                    return operator_commands.record_launch_confirmation(
                        store, command.order, issuer, epoch_us, command.pack
                    )
                case ChangeOrder():
                    return operator_commands.change_order(
                        store, epoch_us, command.order, command.cells, issuer, self.data
                    )
                case CancelOrder():
                    return operator_commands.cancel_order(
                        store,
                        epoch_us,
                        command.order,
                        issuer,
                        command.reason,
                        to_sender=command.to_sender,
                    )
                case HandOver():
                    text = hand_over(store.database, epoch_us, issuer, command.note)
                    return CommandReport([text])
                case AcceptHandover():
                    return CommandReport([accept_handover(store.database, epoch_us, issuer)])
                case SettleOrder():
                    settled = ParcelOutcome(command.settled)
                    return operator_commands.close_order_as_operator(
                        store, epoch_us, command.order, settled, command.reason, issuer
                    )
