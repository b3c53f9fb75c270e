"""A router's figures as Prometheus families of samples (docs/how-to/watch-the-desk.md)."""

from collections.abc import Callable, Iterator

from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from ground_station.adapters.metrics.families import Families, door_families
from ground_station.core.fleet.desk_figures import days_left
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.name_counts import MOST_NAMES
from ground_station.core.fleet.router_figures import RouterFigures

ROUTER = Families("leeway_router_")
KINDS = ("client", "peer", "router")


class RouterCollector(Collector):
    """Reads `figures` once for each page; ages are those of that moment, by `clock`."""

    def __init__(self, figures: Callable[[], RouterFigures | None], clock: Clock) -> None:
        self._figures, self._clock = figures, clock

    def collect(self) -> Iterator[Metric]:
        """All families; none before the router's first turn."""
        figures = self._figures()
        if figures is None:
            return
        since_s = self._clock.monotonic_s() - figures.turned_s
        yield ROUTER.gauge("seconds_since_turn", "Since its loop last came round.", since_s)
        kinds = [(kind, figures.sessions.get(kind, 0)) for kind in KINDS]
        yield ROUTER.gauges("sessions", "Programs joined to it, by zenoh's kind.", "kind", kinds)
        lines = sorted(figures.door.lines.items())[:MOST_NAMES]
        yield ROUTER.gauges("lines", "Open lines, by the caller's certificate.", "member", lines)
        left_days = days_left(figures.certificate_end_us, self._clock.epoch_us())
        about = "Of the certificate that it shows."
        yield ROUTER.gauge("certificate_days_left", about, left_days)
        about = "The number of the roster that it has."
        yield ROUTER.gauge("roster_number", about, figures.roster_number)
        yield from door_families(ROUTER, figures.door)
