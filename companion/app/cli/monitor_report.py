"""A vehicle's service in lines for people."""

import math

from companion.adapters.clock import utc_words
from companion.core.base.safe_text import safe_text
from companion.core.monitor.doubts import doubts_of
from companion.core.monitor.promises import DRAW, PACK, WIND, threshold
from companion.core.monitor.record import Kept, Service
from companion.core.monitor.service import log_e


def report(vehicle: str, service: Service) -> list[str]:
    """Flights, the evidence against each promise, doubts, resets."""
    lines = [f"{vehicle}: {service.flights} flights on {service.day} days"]
    lines += [_line("draw", service.draw, DRAW), _line("wind", service.wind, WIND)]
    lines += [_line(f"pack {name}", kept, PACK) for name, kept in service.packs.items()]
    said = [words for pack in [*service.packs, ""] for words in doubts_of(service, pack).words]
    lines += [safe_text(words) for words in dict.fromkeys(said)] or ["nothing is in doubt"]
    lines += [
        safe_text(
            f"{utc_words(int(reset.epoch_s * 1e6))}: {reset.subject} reset after flight"
            f" {reset.flights} by {reset.by}: {reset.why}"
        )
        for reset in service.resets
    ]
    return lines


def _line(name: str, kept: Kept, promise: str) -> str:
    """Evidence as times: an e-value of 1 says nothing, the alarm's is in brackets."""
    factor = math.exp(min(log_e(kept, promise), 100.0))
    alarm = math.exp(threshold(promise, kept.order))
    word = "ALARM" if kept.alarm_flight is not None else "ok   "
    return f"{word}  {name}: {kept.flights} flights, evidence {factor:.3g} (alarm at {alarm:.0f})"
