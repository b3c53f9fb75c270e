"""The desk's figures as Prometheus families of samples.

docs/how-to/watch-the-desk.md says what each means.
"""

from collections.abc import Callable, Iterable, Iterator

from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from ground_station.adapters.metrics.families import Families, door_families
from ground_station.core.fleet.desk_figures import (
    CertificateFigures,
    CommandFigures,
    DeskFigures,
    MemberFigures,
    OutboxFigures,
    ReplanFigures,
    Standing,
    StoreFigures,
    days_left,
)
from ground_station.core.fleet.fleet_link import Clock

DESK = Families("leeway_desk_")


class DeskCollector(Collector):
    """Reads `figures` once for each page; ages are those of that moment, by `clock`."""

    def __init__(self, figures: Callable[[], DeskFigures | None], clock: Clock) -> None:
        self._figures, self._clock = figures, clock

    def collect(self) -> Iterator[Metric]:
        """All families; none before the desk's first turn."""
        figures = self._figures()
        if figures is None:
            return
        now_s, now_us = self._clock.monotonic_s(), self._clock.epoch_us()
        since_s = now_s - figures.turned_s
        yield DESK.gauge("seconds_since_turn", "Since the desk's loop last came round.", since_s)
        yield DESK.gauge("waiting_messages", "Received, not yet taken in.", figures.waiting)
        yield DESK.gauge(
            "open_network", "1: strangers may listen and command.", figures.open_network
        )
        yield from _members(figures, now_s)
        yield from _commands(figures.commands)
        yield from _outbox(figures.outbox, now_us)
        yield DESK.counters(
            "messages_rejected", "Messages that were no valid ones.", "vehicle", figures.rejected
        )
        yield from _store(figures.store, now_s)
        yield from _replans(figures.replans)
        yield from _certificates(figures.certificates, now_us)
        if figures.door is not None:
            yield from door_families(DESK, figures.door)


def _members(figures: DeskFigures, now_s: float) -> Iterator[Metric]:
    counts = [(standing.value, figures.standings.get(standing, 0)) for standing in Standing]
    yield DESK.gauges("members", "Members by how the desk finds them.", "standing", counts)
    yield DESK.gauge("members_unlisted", "Members too many to be listed.", figures.unlisted)
    if figures.held is not None:
        yield DESK.gauge("members_held", "Members under a hold.", figures.held)
    silences = _silences(figures.members, now_s)
    yield DESK.gauges("member_silence_seconds", "Since its last state.", "vehicle", silences)
    flying = [(member.vehicle, member.flies) for member in figures.members]
    yield DESK.gauges(
        "member_flying", "1: launched, and its flight is not over.", "vehicle", flying
    )


def _silences(members: Iterable[MemberFigures], now_s: float) -> Iterator[tuple[str, float]]:
    for member in members:
        if member.heard_s is not None:
            yield member.vehicle, now_s - member.heard_s


def _commands(figures: CommandFigures) -> Iterator[Metric]:
    about = "From a command's first sending to its final answer."
    yield DESK.times("command_answer_seconds", about, "deed", figures.answer_times)
    waiting = figures.unanswered.items()
    yield DESK.gauges("commands_unanswered", "Sent, and no final answer yet.", "deed", waiting)
    about = "Sendings of commands that nobody answered in time."
    yield DESK.counters("command_timeouts", about, "deed", figures.timeouts)


def _outbox(figures: OutboxFigures | None, now_us: int) -> Iterator[Metric]:
    if figures is None:
        return
    yield DESK.gauge("outbox_commands", "Without a final answer, sent or not.", figures.rows)
    if figures.oldest_us is not None:
        age_s = (now_us - figures.oldest_us) / 1e6
        yield DESK.gauge("outbox_oldest_seconds", "Since the oldest of them was written.", age_s)


def _store(figures: StoreFigures, now_s: float) -> Iterator[Metric]:
    since_s = figures.away_since_s
    yield DESK.gauge("store_up", "0: the store is away, nothing is decided.", since_s is None)
    away_s = 0.0 if since_s is None else now_s - since_s
    yield DESK.gauge("store_away_seconds", "Since the store has been away.", away_s)
    yield DESK.counter("store_retries", "Tries of a store that was away.", figures.retries)
    if figures.write_took_s is not None:
        about = "How long its newest writing transaction took."
        yield DESK.gauge("store_transaction_seconds", about, figures.write_took_s)


def _replans(figures: ReplanFigures | None) -> Iterator[Metric]:
    if figures is None:
        return
    yield DESK.gauge("replanning", "1: a new plan is being made.", figures.is_replanning)
    yield DESK.times("replan_seconds", "How long a new plan took.", "result", figures.times)


def _certificates(figures: CertificateFigures | None, now_us: int) -> Iterator[Metric]:
    if figures is None:
        return
    own_us = figures.own_us
    own_days = 0.0 if own_us is None else days_left(own_us, now_us)
    about = "Of the desk's own; 0: not on the roster, or revoked."
    yield DESK.gauge("own_certificate_days_left", about, own_days)
    ends = [(name, days_left(end_us, now_us)) for name, end_us in figures.members_us]
    yield DESK.gauges("certificate_days_left", "Of each member's, by the roster.", "member", ends)
