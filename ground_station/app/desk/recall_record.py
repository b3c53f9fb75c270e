"""What a recall leaves in the store: a hold, commands and answers; written when it can be."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from companion.fleet.messages import Answered, Recall
from ground_station.adapters.store.database import StoreError
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_link import Clock

AGAIN_S = 1.0
"""A store that is away is tried again at this interval while the recall is waited for."""


@dataclass(slots=True)
class RecallRecord:
    """The record of one `recall`. `open_store` may raise StoreError, now or always."""

    open_store: Callable[[], Store]
    by: str
    say: Callable[[str], None]
    clock: Clock
    why_not: str | None = None
    _store: Store | None = None
    _scope: str = ""
    _asked: dict[str, str] = field(default_factory=dict)
    _is_held: bool = False
    _open: set[str] = field(default_factory=set)
    _tried_s: float = 0.0

    def begin(self, scope: str, asked: dict[str, str]) -> None:
        """Hold what is recalled, and write the commands (id, vehicle), which are sent already."""
        self._scope, self._asked = scope, dict(asked)
        self._tried_s = self.clock.monotonic_s()
        self._try(self._begin)
        if self.why_not is not None:
            self.say(f"recalled without the store, NOT HELD yet: {self.why_not}")

    def _begin(self) -> None:
        self._store = self._store or self.open_store()
        if not self._is_held:
            self._hold(HoldStore(self._store.database, self.clock.epoch_us))
        for id_ in list(self._asked):
            self._store.command(id_, self._asked[id_], Recall(), self.by)
            self._open.add(id_)
            del self._asked[id_]

    def _hold(self, holds: HoldStore) -> None:
        sent = holds.set([self._scope], "recalled", self.by)
        self._is_held = True
        for assignment in sent:
            self.say(f"LOOK: the launch of {assignment} was sent before: it may take off")

    def end(self, answers: Mapping[str, Answered]) -> None:
        """Write the answers that have come; where the store was away, all that is to be written."""
        now_s = self.clock.monotonic_s()
        if self.why_not is not None and now_s - self._tried_s < AGAIN_S:
            return
        self._tried_s = now_s
        self._try(self._begin)
        for id_ in sorted(self._open & answers.keys()):
            self._try(lambda id_=id_: self._answer(id_, answers[id_]))

    def _answer(self, id_: str, answer: Answered) -> None:
        assert self._store is not None
        self._store.answered(id_, answer, "", "recall")
        self._open.discard(id_)

    def give_up(self) -> None:
        """Nothing is sent any more: take what is not answered out of the outbox."""
        store = self._store
        if store is not None:
            for id_ in sorted(self._open):
                self._try(lambda id_=id_: _void(store, id_))

    def _try(self, write: Callable[[], None]) -> None:
        try:
            write()
            self.why_not = None
        except StoreError as error:
            self.why_not = str(error)

    @property
    def is_written(self) -> bool:
        """Whether the hold is in force, and all that was sent is in the store."""
        return self._is_held and not self._asked

    def close(self) -> None:
        """Close the store."""
        if self._store is not None:
            self._store.close()


def _void(store: Store, id_: str) -> None:
    store.give_up(id_, "not answered in time")
