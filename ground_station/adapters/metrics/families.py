"""Families of samples as Prometheus takes them, under one program's prefix.

Names of members and deeds come from messages and certificates that were checked, so no label needs
an escape.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)

from ground_station.core.fleet.door import DoorFigures
from ground_station.core.fleet.time_counts import TimesBy


@dataclass(frozen=True, slots=True)
class Families:
    """Makes the families of one program."""

    prefix: str

    def gauge(self, name: str, about: str, value: float) -> Metric:
        """One value."""
        return GaugeMetricFamily(self.prefix + name, about, value=value)

    def gauges(
        self, name: str, about: str, label: str, samples: Iterable[tuple[str, float]]
    ) -> Metric:
        """A value for each value of a label."""
        family = GaugeMetricFamily(self.prefix + name, about, labels=[label])
        for value, sample in samples:
            family.add_metric([value], sample)
        return family

    def counter(self, name: str, about: str, value: float) -> Metric:
        """One count since the program began."""
        return CounterMetricFamily(self.prefix + name, about, value=value)

    def counters(self, name: str, about: str, label: str, counts: Mapping[str, int]) -> Metric:
        """A count for each value of a label."""
        family = CounterMetricFamily(self.prefix + name, about, labels=[label])
        for value, count in counts.items():
            family.add_metric([value], count)
        return family

    def times(self, name: str, about: str, label: str, times: TimesBy) -> Metric:
        """A histogram for each value of a label."""
        family = HistogramMetricFamily(self.prefix + name, about, labels=[label])
        for value, took in times.items():
            bounds = [*(str(bound) for bound in took.bounds_s), "+Inf"]
            buckets = list(zip(bounds, accumulate(took.counts), strict=True))
            family.add_metric([value], buckets, sum_value=took.sum_s)
        return family


def door_families(families: Families, door: DoorFigures) -> Iterator[Metric]:
    """Who is on its lines that should not be, and who was turned away."""
    about = "1: on a line, though its certificate has ended, or it is revoked or not listed."
    unwelcome = [(name, 1.0) for name in sorted(door.unwelcome)]
    yield families.gauges("unwelcome_member", about, "member", unwelcome)
    if door.turned_away is not None:
        about = "Calls over TLS that got no line."
        counts = {why.value: count for why, count in door.turned_away.items()}
        yield families.counters("calls_turned_away", about, "why", counts)
