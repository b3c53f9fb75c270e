"""The page that Prometheus reads: a program's figures and its process's, as text."""

import threading

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.registry import Collector

from ground_station.core.fleet.fleet_link import Clock

FRESH_S = 1.0
"""A program takes its figures once a second. Making the page holds up its thread, some tens
of milliseconds with a thousand members: not more often, however many ask for it.
"""


class MetricsPage:
    """Thread-safe. `figures` collects the newest of the program."""

    def __init__(self, figures: Collector, clock: Clock) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(figures)
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
