"""The page that Prometheus reads: the desk's figures and its process's, as text."""

import threading
from collections.abc import Callable

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest

from ground_station.adapters.metrics.desk_collector import DeskCollector
from ground_station.core.fleet.desk_figures import DeskFigures
from ground_station.core.fleet.fleet_link import Clock

FRESH_S = 1.0
"""The desk takes its figures once a second. Making the page holds up the desk's thread, some tens
of milliseconds with a thousand members: not more often, however many ask for it.
"""


class MetricsPage:
    """Thread-safe. `figures` gives the newest of the desk."""

    def __init__(self, figures: Callable[[], DeskFigures | None], clock: Clock) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(DeskCollector(figures, clock))
        ProcessCollector(registry=self._registry)
        self._clock = clock
        self._making = threading.Lock()
        self._made_s: float | None = None
        self._made = b""

    def text(self) -> bytes:
        """The page, at most `FRESH_S` old."""
        with self._making:
            now_s = self._clock.monotonic_s()
            if self._made_s is None or now_s - self._made_s >= FRESH_S:
                self._made, self._made_s = generate_latest(self._registry), now_s
            return self._made
