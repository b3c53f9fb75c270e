"""Record of a recall in the store: hold, commands and responses, written when it is reachable."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from companion.fleet.messages import CommandStatus, Recall
from ground_station.adapters.store.database import StoreError
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_link import Clock

RETRY_INTERVAL_S = 1.0
"""Retry interval of an unreachable store while the recall waits for responses."""


@dataclass(slots=True)
class RecallRecord:
    """Record of one `recall`. `open_store` may raise StoreError temporarily or permanently."""

    open_store: Callable[[], Store]
    issuer: str
    log: Callable[[str], None]
    clock: Clock
    store_error: str | None = None
    _store: Store | None = None
    _scope: str = ""
    _unstored_commands: dict[str, str] = field(default_factory=dict)
    _hold_is_set: bool = False
    _unanswered: set[str] = field(default_factory=set)
    _last_attempt_s: float = 0.0

    def place_hold_and_store_commands(self, scope: str, commands: dict[str, str]) -> None:
        """Store the hold and the commands (id, vehicle), which have been sent already."""
        self._scope, self._unstored_commands = scope, dict(commands)
        self._last_attempt_s = self.clock.monotonic_s()
        self._try_write_and_record_error(self._store_missing_hold_and_commands)
        if self.store_error is not None:
            self.log(f"recall continues; launch hold not stored yet: {self.store_error}")

    def _store_missing_hold_and_commands(self) -> None:
        self._store = self._store or self.open_store()
        if not self._hold_is_set:
            hold_store = HoldStore(self._store.database, self.clock.epoch_us)
            sent = hold_store.place_holds([self._scope], "recalled", self.issuer)
            self._hold_is_set = True
            for one in sent:
                self.log(f"WARNING: {one} may take off, launch already sent: keep pad clear")
        for id_ in list(self._unstored_commands):
            self._store.enqueue_command(id_, self._unstored_commands[id_], Recall(), self.issuer)
            self._unanswered.add(id_)
            del self._unstored_commands[id_]

    def store_responses_and_missed_entries(self, responses: Mapping[str, CommandStatus]) -> None:
        """Store received responses, and all entries that an unreachable store has missed."""
        now_s = self.clock.monotonic_s()
        if self.store_error is not None and now_s - self._last_attempt_s < RETRY_INTERVAL_S:
            return
        self._last_attempt_s = now_s
        self._try_write_and_record_error(self._store_missing_hold_and_commands)
        for id_ in sorted(self._unanswered & responses.keys()):
            self._try_write_and_record_error(
                lambda id_=id_: self._store_response(id_, responses[id_])
            )

    def _store_response(self, id_: str, response: CommandStatus) -> None:
        assert self._store is not None
        self._store.record_and_apply_response(id_, response, "", "recall")
        self._unanswered.discard(id_)

    def void_unanswered_commands(self) -> None:
        """Remove unanswered commands from the outbox, so that they are not sent again."""
        store = self._store
        if store is not None:
            for id_ in sorted(self._unanswered):
                self._try_write_and_record_error(
                    lambda id_=id_: store.cancel_command(id_, "not answered in time")
                )

    def _try_write_and_record_error(self, write: Callable[[], object]) -> None:
        try:
            write()
            self.store_error = None
        except StoreError as error:
            self.store_error = str(error)

    @property
    def is_hold_placed_and_commands_stored(self) -> bool:
        """Whether the hold is in force and all sent commands are in the store."""
        return self._hold_is_set and not self._unstored_commands

    def close(self) -> None:
        """Close the store."""
        if self._store is not None:
            self._store.close()
