"""A client that reads the desk's figures as Prometheus does, with Prometheus's own parser."""

import socket
import time
from collections.abc import Callable
from urllib.request import urlopen

from prometheus_client.parser import text_string_to_metric_families

from ground_station.adapters.clock import monotonic_s

PATIENCE_S = 60.0


class Scrape:
    """The samples of one page: `of(name, label=value)`."""

    def __init__(self, text: str) -> None:
        self.text = text
        families = list(text_string_to_metric_families(text))
        self.families = {family.name for family in families}
        samples = [sample for family in families for sample in family.samples]
        self.values = {(s.name, frozenset(s.labels.items())): s.value for s in samples}

    def of(self, name: str, **labels: str) -> float | None:
        """One sample of the desk's; None: the page has none."""
        return self.values.get((f"leeway_desk_{name}", frozenset(labels.items())))

    def label_values(self, name: str, label: str) -> set[str]:
        """The values that a label of these samples takes."""
        return {dict(labels)[label] for n, labels in self.values if n == f"leeway_desk_{name}"}


def scrape(port: int, patience_s: float = PATIENCE_S) -> Scrape:
    """The page now."""
    with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=patience_s) as answer:
        assert answer.headers["Content-Type"].startswith("text/plain")
        return Scrape(answer.read().decode())


def scrape_until(port: int, true: Callable[[Scrape], object]) -> Scrape:
    """The first page of which it is true."""
    limit_s = monotonic_s() + PATIENCE_S
    while not true(seen := scrape(port)):
        assert monotonic_s() < limit_s, seen.text
        time.sleep(0.1)
    return seen


def connected(port: int, say: bytes = b"") -> socket.socket:
    """A client that connects, says so much, and nothing more."""
    line = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
    line.sendall(say)
    return line
