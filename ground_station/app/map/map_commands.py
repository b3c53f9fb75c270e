"""Executes operator commands from the map: opens store and network for each command."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk import operator_commands
from ground_station.app.desk.operator_commands import CommandReport
from ground_station.core.fleet.fleet_link import FleetLink
from ground_station.core.people.map_command_messages import (
    ConfirmLaunch,
    HoldDrone,
    RecallDrone,
    ReleaseDrone,
    SettleOrder,
    WebCommand,
)
from ground_station.core.people.person import DeskOperator
from ground_station.core.people.web_tokens import command_refusal_reason
from ground_station.core.schema.order_states import ParcelOutcome

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

    def execute_command(self, operator: DeskOperator, command: WebCommand) -> dict[str, Any]:
        """Execute a command; return its result and the items to check. Raises LeewayError."""
        refusal = command_refusal_reason(operator)
        if refusal:
            raise LeewayError(refusal)
        issuer = self.audit_identity(operator).name
        report = (
            self._recall(command, issuer)
            if isinstance(command, RecallDrone)
            else self._execute_store_command(command, issuer)
        )
        return {"words": report.messages, "look": report.checks}

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

    def _execute_store_command(
        self, command: HoldDrone | ReleaseDrone | ConfirmLaunch | SettleOrder, issuer: str
    ) -> CommandReport:
        with closing(self.open_store()) as store:
            match command:
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
                        store, command.order, issuer
                    )
                case SettleOrder():
                    settled = ParcelOutcome(command.settled)
                    return operator_commands.close_order_as_operator(
                        store, epoch_us, command.order, settled, command.reason, issuer
                    )
