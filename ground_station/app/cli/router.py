"""`ground-station router`: passes on messages between members that cannot call each other."""

import threading
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ground_station.adapters.clock import WallClock, epoch_us, monotonic_s
from ground_station.app.cli.metrics import MetricsAddress, OpenMetrics, hold_port
from ground_station.app.cli.stopping import stop_signals
from ground_station.app.views.times import time_of_day

if TYPE_CHECKING:
    from ground_station.adapters.metrics.metrics_server import MetricsServer
    from ground_station.adapters.zenoh_router import ZenohRouter
    from ground_station.core.fleet.router_figures import RouterFigures

TURN_S = 0.5
FIGURES_S = 1.0

app = typer.Typer()


@app.command()
def router(
    identity: Annotated[
        Path,
        typer.Option(
            help="The router's folder of `ground-station pki add NAME --role router` (needed)."
        ),
    ],
    metrics: MetricsAddress = None,
    open_metrics: OpenMetrics = False,
) -> None:
    """Pass a fleet's messages on, between members and desks that cannot call one another.

    Where the desk has no address that vehicles reach (behind a mobile network, say), a router
    stands where all reach it. Desk, vehicles and people call it and one another through it; their
    own network files name it. Add a second one, and members go on through it when the first is
    gone. Nobody believes a router: what counts is signed, from end to end. It lets in who has a
    certificate of the fleet, passes on what that member may say, and says who calls and should not.

    Ctrl-C ends it: members call the next router, or this one when it is back. A roster of `pki add`
    or `pki revoke` comes to it from the desk: it opens anew, and members call again within seconds.
    Exit code 2: a mistake in the settings.

    ground-station pki add r1 --role router --address r1.harbour.example:7447
    ground-station router --identity /var/lib/leeway-router/identity --metrics 9465
    """
    from ground_station.adapters.zenoh_log import read_zenoh_log
    from ground_station.adapters.zenoh_router import ZenohRouter

    log = read_zenoh_log()
    with hold_port(metrics, open_metrics) as server:
        opened = ZenohRouter.open(identity, _say, log, _say)
        with closing(opened):
            fleet = opened.door.roster().fleet
            typer.echo(f"{opened.name}: router of {fleet} at {opened.address}; Ctrl-C stops")
            _run(opened, server)
        typer.echo(f"{opened.name}: stopped")


def _run(opened: "ZenohRouter", server: "MetricsServer | None") -> None:
    """Turn until stopped. zenoh's own threads pass the messages on."""
    from companion.fleet.service_manager import Watchdog
    from ground_station.core.fleet.door_watch import DoorWatch

    watchdog, watch = Watchdog(), DoorWatch(opened.door.figures, opened.door.roster, _say)
    meter, stop = RouterMeter(opened), threading.Event()
    if server is not None:
        meter.serve(server)
    said: set[str] = set()
    with stop_signals() as stopped:
        while not stopped:
            now_s = monotonic_s()
            watchdog.turn(now_s)
            opened.turn(now_s)
            watch.turn(now_s, epoch_us())
            meter.turn(now_s)
            _say_once(opened.identity.trust.warning(), said)
            stop.wait(TURN_S)  # a signal ends it


class RouterMeter:
    """Takes the router's figures once a second, where any thread may read them."""

    def __init__(self, opened: "ZenohRouter") -> None:
        self._opened = opened
        self.figures: RouterFigures | None = None

    def turn(self, now_s: float) -> None:
        """Take them, if it is time to."""
        if self.figures is None or now_s - self.figures.turned_s >= FIGURES_S:
            self.figures = self._opened.figures(now_s)

    def serve(self, server: "MetricsServer") -> None:
        """Begin to serve them."""
        from ground_station.adapters.metrics.metrics_page import MetricsPage
        from ground_station.adapters.metrics.router_collector import RouterCollector

        clock = WallClock()
        server.serve(MetricsPage(RouterCollector(lambda: self.figures, clock), clock).text)


def _say_once(words: str, said: set[str]) -> None:
    if words and words not in said:
        said.add(words)
        _say(words)


def _say(words: str) -> None:
    typer.echo(f"{time_of_day(epoch_us())} {words}")
