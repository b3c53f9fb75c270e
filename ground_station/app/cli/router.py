"""`ground-station router`: forwards messages between members of a fleet."""

import threading
from contextlib import closing
from typing import TYPE_CHECKING

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.service_manager import record_stop_signals
from ground_station.adapters.clock import monotonic_s
from ground_station.app.options.desk_options import desk_options, echo_with_time_of_day
from ground_station.app.options.program_options import command_class_with_options

if TYPE_CHECKING:
    from ground_station.adapters.zenoh_router import ZenohRouter

LOOP_INTERVAL_S = 0.5

app = typer.Typer()


@app.command(cls=command_class_with_options("identity"))
def router() -> None:
    """Forward messages between members without a direct connection.

    Use a router if the desk has no address that vehicles can reach, for example behind a mobile
    network. All members connect to the router that their network files name. With a second
    router, members switch to it if the first fails. Messages are signed end to end, so a router
    is not trusted. It admits members with a certificate of the fleet and forwards only messages
    that their role permits.

    Ctrl-C stops it; members connect to the next router. The desk sends a new roster of `pki add`
    or `pki revoke`; the router restarts its session, and members reconnect within seconds.
    Exit code 2: invalid settings.

    ground-station pki add r1 --role router --address r1.harbour.example:7447
    ground-station router --identity /var/lib/leeway-router/identity
    """
    from ground_station.adapters.zenoh_router import ZenohRouter

    identity = desk_options().identity
    if identity is None:
        raise LeewayError(
            "router: expected --identity, a folder of `ground-station pki add NAME --role router`"
        )
    zenoh_router = ZenohRouter.open_router(identity, echo_with_time_of_day, echo_with_time_of_day)
    with closing(zenoh_router):
        fleet = zenoh_router.identity.trust.roster.fleet
        typer.echo(
            f"{zenoh_router.name}: router of {fleet} at {zenoh_router.address}; Ctrl-C stops"
        )
        _run_router_until_signal(zenoh_router)
    typer.echo(f"{zenoh_router.name}: stopped")


def _run_router_until_signal(zenoh_router: "ZenohRouter") -> None:
    """Run until a signal. The threads of zenoh forward the messages."""
    from companion.fleet.service_manager import Watchdog

    watchdog, stop, logged = Watchdog(), threading.Event(), set[str]()
    with record_stop_signals() as received_signals:
        while not received_signals:
            now_s = monotonic_s()
            watchdog.notify_systemd_if_due(now_s)
            zenoh_router.accept_roster_and_reopen_if_stale(now_s)
            _log_message_once(zenoh_router.identity.trust.certificate_warning_or_empty(), logged)
            stop.wait(LOOP_INTERVAL_S)  # a signal ends it


def _log_message_once(message: str, logged_messages: set[str]) -> None:
    if message and message not in logged_messages:
        logged_messages.add(message)
        echo_with_time_of_day(message)
