"""`--metrics` of `ground-station dispatch` and `router`: where Prometheus reads figures."""

import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.listening_socket import is_loopback

if TYPE_CHECKING:
    from ground_station.adapters.metrics.metrics_server import MetricsServer
    from ground_station.adapters.zenoh_fleet import ZenohFleet
    from ground_station.app.desk.desk import Desk
    from ground_station.app.desk.desk_meter import DeskMeter

HERE = "127.0.0.1"
ADDRESS = re.compile(r"(?:(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9.-]+):)?(?P<port>[0-9]{1,5})")

MetricsAddress = Annotated[
    str | None,
    typer.Option(
        "--metrics",
        metavar="[HOST:]PORT",
        help="Serve its figures for Prometheus on this port, at /metrics; a port alone is"
        " this machine's. Whoever reaches it reads the fleet's state.",
    ),
]
OpenMetrics = Annotated[
    bool,
    typer.Option(
        "--open-metrics",
        help="Allow --metrics at an address that other machines reach: all who do read where the"
        " fleet's trouble is. They can command nothing.",
    ),
]


@contextmanager
def hold_port(address: str | None, open_metrics: bool) -> "Iterator[MetricsServer | None]":
    """Take the port before anything is written or sent; LeewayError where it cannot be had."""
    if address is None:
        yield None
        return
    host, port = metrics_address(address, open_metrics)
    try:
        from ground_station.adapters.metrics.metrics_server import MetricsServer
    except ImportError as error:
        raise LeewayError(f"--metrics needs leeway-uas[ground]: {error}") from error
    with closing(MetricsServer(host, port)) as server:
        yield server


def metrics_address(address: str, open_metrics: bool) -> tuple[str, int]:
    """(host, port); LeewayError where it is none, or strangers would reach it unasked."""
    found = ADDRESS.fullmatch(address)
    port = int(found["port"]) if found else 0
    if found is None or not 1 <= port <= 65535:
        raise LeewayError(f"--metrics {address!r}: expected PORT or HOST:PORT")
    host = (found["host"] or HERE).strip("[]")
    if not (open_metrics or is_loopback(host)):
        raise LeewayError(
            f"--metrics {address}: whoever reaches it reads the fleet's state:"
            f" expected {HERE}:{port}, or --open-metrics"
        )
    return host, port


def serve_desk(server: "MetricsServer", desk: "Desk", fleet: "ZenohFleet") -> "DeskMeter":
    """Begin to serve this desk's figures, which the meter takes in the desk's turns."""
    from ground_station.adapters.metrics.desk_collector import DeskCollector
    from ground_station.adapters.metrics.metrics_page import MetricsPage
    from ground_station.app.desk.desk_meter import DeskMeter

    meter = DeskMeter(desk, fleet)
    clock = desk.exchange.clock
    server.serve(MetricsPage(DeskCollector(lambda: meter.figures, clock), clock).text)
    return meter
