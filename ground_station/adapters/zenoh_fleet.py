"""The desk's end of a fleet over zenoh: what arrives goes into the inbox, as bytes.

Nothing that asks blocks: answers come by way of the inbox too.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from companion.core.base.errors import LeewayError
from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.event_log import BATCH
from companion.fleet.membership import ON_ITS_OWN, JoinOptions
from companion.fleet.messages import Command, Refused, Result, decode_result, encode
from companion.fleet.network import WIND_COV
from companion.fleet.roles import MEASURES, SPEAKS
from companion.fleet.topics import VehicleKeys, life_of, station_key, vehicle_of
from companion.fleet.zenoh_config import read_config
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.fleet_inbox import FleetInbox
from ground_station.core.fleet.desk_figures import CertificateFigures, certificates_of
from ground_station.core.fleet.fleet_link import FleetInput, StateReceived

if TYPE_CHECKING:
    from companion.fleet.identity import Identity
    from companion.fleet.roster import Roster
    from companion.fleet.trust import Trust
    from ground_station.adapters.called_session import CalledSession
    from ground_station.adapters.neighbour_line import NeighbourLine
    from ground_station.adapters.roster_share import RosterShare
    from ground_station.adapters.zenoh_door import ZenohDoor
    from ground_station.adapters.zenoh_log import DoorLog


class ZenohFleet:
    """The desk's end of one fleet."""

    def __init__(
        self,
        fleet: str,
        config: Path | None,
        options: JoinOptions = ON_ITS_OWN,
        door_log: "DoorLog | None" = None,
        say: Callable[[str], None] = lambda words: None,
        neighbours: Sequence[str] = (),
    ) -> None:
        """Join with this configuration file (JSON5), or as `options` say. `door_log`: who is turned
        away. `say`: that the session has opened anew. `neighbours`: fleets whose tracks are brought
        to our vehicles; without an identity all are on one network.

        Raises LeewayError where a file is not valid, or the network refuses us.
        """
        self._say = say
        self.open_network = options.open_network
        self._keys = VehicleKeys(fleet, "*")
        self._fleet = fleet
        identity = _identity(fleet, options)
        self._identity = identity
        self._trust = identity.trust if identity is not None else None
        self._ends: tuple[Roster, int | None, CertificateFigures] | None = None
        self.inbox = FleetInbox(self._opened, is_member=self._is_member)
        self._called: CalledSession | None = None
        if config is None and identity is not None:
            self._called = _called(identity, open_network=options.open_network)
            session = self._called.open()
        else:
            session = _opened_once(config, open_network=options.open_network)
        self.door = _door_of(session, self._trust, door_log)
        self._use(session)
        self._lines = self._open_lines(identity, neighbours)

    def _use(self, session: zenoh.Session) -> None:
        """Listen and speak by this session from now on."""
        self._session = session
        if self.door is not None:
            self.door.session = session
        self._roster = _share_of(session, self._identity, self._refuse_roster)
        liveliness = self._session.liveliness()
        self._held = (  # zenoh undeclares what nobody holds
            self._session.declare_subscriber(self._keys.state, self._on_state),
            self._session.declare_subscriber(self._keys.event, self._on_event),
            self._session.declare_subscriber(station_key(self._fleet, "*"), self._on_station),
            liveliness.declare_subscriber(self._keys.alive(), self._on_liveliness, history=True),
        )

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Everything that has come; waits this long for the first."""
        if self._roster is not None:
            self._roster.turn(monotonic_s())
        if self._called is not None and self._called.is_old(monotonic_s()):
            self._open_again(self._called)
        heard = self.inbox.receive(wait_s)
        for line in self._lines.values():
            line.turn(monotonic_s())
            for one in heard:
                if isinstance(one, StateReceived):
                    line.be_near(one.state)
        return heard

    def _open_again(self, called: "CalledSession") -> None:
        """Take up what is new of rules and certificates. What was asked counts as unanswered, and
        what members tell meanwhile is asked for again.
        """
        from ground_station.adapters.called_session import anew_words

        self._use(called.open_again(self._session, monotonic_s()))
        self._say(anew_words(called.identity.trust.roster))

    def _open_lines(
        self, identity: "Identity | None", fleets: Sequence[str]
    ) -> "dict[str, NeighbourLine]":
        if identity is None or not fleets:
            return {}
        from ground_station.adapters.neighbour_line import open_lines

        for fleet in set(fleets) - set(identity.trust.roster.neighbours):
            self._say(
                f"neighbour {fleet}: our vehicles may not hear it:"
                f" `ground-station pki add {fleet} --role neighbour` in our own folder"
            )
        try:
            lines = open_lines(self._fleet, identity.folder, [*fleets], self._pass_on, self._say)
        except LeewayError:
            self._session.close()
            raise
        return {line.fleet: line for line in lines}

    def _pass_on(self, key: str, raw: bytes) -> None:
        """A neighbour's track, to our vehicles. While our session opens anew it is lost."""
        with contextlib.suppress(zenoh.ZError):
            self._session.put(key, raw, express=True)

    def neighbour_keys(self, fleet: str) -> Mapping[str, str]:
        """The public keys of a neighbouring fleet's vehicles, by name."""
        line = self._lines.get(fleet)
        return {} if line is None else line.keys()

    @property
    def warning(self) -> str:
        """What a person should know about this end's own standing; empty: nothing."""
        return self._trust.warning() if self._trust is not None else ""

    @property
    def waiting(self) -> int:
        """Messages that have come and are not taken in yet."""
        return self.inbox.waiting

    def certificates(self) -> CertificateFigures | None:
        """When they end, by the roster in force; None: we are here without an identity."""
        if self._trust is None:
            return None
        self._trust.look_if_near()
        roster, end_us = self._trust.roster, self._trust.end_us
        if self._ends is None or self._ends[0] is not roster or self._ends[1] != end_us:
            self._ends = roster, end_us, certificates_of(roster, self._trust.name, end_us)
        return self._ends[2]

    def ask_states(self, wait_s: float) -> None:
        """Ask every member for its newest state, and the network for the tokens of who is there."""
        self.inbox.begin_roll_call()
        self._session.liveliness().get(self._keys.alive(), self._on_life_reply, timeout=wait_s)
        selector = f"{self._keys.state}?{WIND_COV}"
        self._session.get(selector, self._on_state_reply, timeout=wait_s)

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Ask a member for the events that it keeps after this number."""
        raws: list[bytes] = []

        def take(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None or vehicle_of(str(sample.key_expr)) != vehicle:
                return
            if len(raws) < BATCH:
                raws.append(sample.payload.to_bytes())

        def done() -> None:
            if raws:
                self.inbox.hear_replay(vehicle, raws)

        selector = f"{VehicleKeys(self._fleet, vehicle).event}?after={after}"
        self._session.get(
            selector,
            zenoh.handlers.Callback(take, done),
            timeout=wait_s,
            consolidation=zenoh.ConsolidationMode.NONE,  # every event has the same key
        )

    def send(self, command: Command, wait_s: float) -> None:
        """Send a command. Its answer, or the time-out, is received."""
        results: list[Result] = []

        def take(reply: zenoh.Reply) -> None:
            result = self._result(reply, command.vehicle)
            if result is None or results:
                return
            if result.id == command.id:
                results.append(result)
            else:
                self.inbox.reject(command.vehicle, f"did not take a command: {result.reason}")

        def done() -> None:
            self.inbox.hear_answer(command.id, results[0] if results else None)

        key = VehicleKeys(self._fleet, command.vehicle).command
        self._session.get(
            key,
            zenoh.handlers.Callback(take, done),
            payload=self._sealed(command),
            timeout=wait_s,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            express=True,
        )

    def _sealed(self, command: Command) -> bytes:
        raw = encode(command)
        return raw if self._trust is None else self._trust.seal("command", raw)

    def tell_winds(self, winds: SharedWinds) -> None:
        """Tell one vehicle the winds that others feel, signed where we have an identity."""
        raw = encode(winds)
        sealed = raw if self._trust is None else self._trust.seal("winds", raw)
        self._session.put(VehicleKeys(self._fleet, winds.vehicle).wind, sealed, express=True)

    def close(self) -> None:
        """Leave the network."""
        for line in self._lines.values():
            line.close()
        self._session.close()

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        seen = life_of(str(sample.key_expr))
        if seen is not None:
            if self._roster is not None and sample.kind == zenoh.SampleKind.PUT:
                self._roster.somebody_joined()
            self.inbox.hear_life(*seen, up=sample.kind == zenoh.SampleKind.PUT)

    def _on_life_reply(self, reply: zenoh.Reply) -> None:
        if (sample := reply.ok) is not None and (seen := life_of(str(sample.key_expr))) is not None:
            self.inbox.hear_present(*seen)

    def _on_state(self, sample: zenoh.Sample) -> None:
        self.inbox.hear_state(str(sample.key_expr), sample.payload.to_bytes())

    def _on_event(self, sample: zenoh.Sample) -> None:
        self.inbox.hear_event(str(sample.key_expr), sample.payload.to_bytes())

    def _on_station(self, sample: zenoh.Sample) -> None:
        self.inbox.hear_station(str(sample.key_expr), sample.payload.to_bytes())

    def _on_state_reply(self, reply: zenoh.Reply) -> None:
        if (sample := reply.ok) is not None:
            key, raw = str(sample.key_expr), sample.payload.to_bytes()
            self.inbox.hear_state(key, raw, asked=True)

    def _result(self, reply: zenoh.Reply, vehicle: str) -> Result | None:
        """The answer of the vehicle that was asked; anything else is rejected."""
        sample = reply.ok
        if sample is None:
            return None
        told = self._opened("result", sample.payload.to_bytes(), vehicle)
        result: Any = told if isinstance(told, Refused) else decode_result(told)
        if isinstance(result, Refused):
            self.inbox.reject(vehicle, result.reason)
            return None
        if not result.vehicle == vehicle == vehicle_of(str(sample.key_expr)):
            self.inbox.reject(vehicle, f"an answer speaks for {result.vehicle}")
            return None
        return result

    def _refuse_roster(self, why: str) -> None:
        self.inbox.reject("roster", why)

    def _is_member(self, vehicle: str) -> bool:
        """Whether the roster lists it; without an identity everybody on this machine is one."""
        return self._trust is None or vehicle in self._trust.roster.by_name

    def _opened(self, kind: str, raw: bytes, vehicle: str) -> bytes | Refused:
        """The message itself, if `vehicle` has signed it; without an identity, as it came."""
        if self._trust is None:
            return raw
        roles = MEASURES if kind == "station" else SPEAKS
        told = self._trust.told(kind, raw, vehicle, roles)
        return Refused(f"not believed: {told.reason}") if isinstance(told, Refused) else told


def _identity(fleet: str, options: JoinOptions) -> "Identity | None":
    """The identity of a program that has one: cryptography is loaded only for those."""
    if options.identity is None:
        return None
    from companion.fleet.identity import identity_of

    return identity_of(options.identity, fleet)


def _called(identity: "Identity", *, open_network: bool) -> "CalledSession":
    from ground_station.adapters.called_session import CalledSession

    return CalledSession(identity, open_network)


def _opened_once(file: Path | None, *, open_network: bool) -> zenoh.Session:
    try:
        return zenoh.open(read_config(file, open_network=open_network))
    except zenoh.ZError as error:
        raise LeewayError(f"{file or 'zenoh'}: {error}") from error


def _share_of(
    session: zenoh.Session, identity: "Identity | None", refuse: Callable[[str], None]
) -> "RosterShare | None":
    if identity is None:
        return None
    from ground_station.adapters.roster_share import RosterShare

    return RosterShare(session, identity, refuse)


def _door_of(
    session: zenoh.Session, trust: "Trust | None", log: "DoorLog | None"
) -> "ZenohDoor | None":
    if trust is None:
        return None
    from ground_station.adapters.zenoh_door import ZenohDoor

    return ZenohDoor(session, trust, log)
