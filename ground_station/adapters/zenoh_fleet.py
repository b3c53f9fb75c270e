"""The desk's connection to a fleet over zenoh: received bytes go into the inbox.

Requests do not block: their replies arrive through the inbox too.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import zenoh

from companion.core.base.desk_heartbeat import DeskHeartbeat
from companion.core.base.errors import LeewayError
from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.event_log import MAX_EVENTS_PER_REPLY
from companion.fleet.identity import read_identity_of_fleet_and_member
from companion.fleet.membership import DEFAULT_JOIN_OPTIONS, JoinOptions
from companion.fleet.messages import (
    KIND_OF_TYPE,
    Command,
    Refused,
    Result,
    decode_message,
    encode_message,
)
from companion.fleet.network import WIND_COV
from companion.fleet.roles import STATE_PUBLISHERS, WIND_PUBLISHERS, WIND_STATIONS
from companion.fleet.roster import Roster
from companion.fleet.topics import (
    VehicleKeys,
    desk_key,
    station_wind_key,
    vehicle_and_instance_from_key,
    vehicle_from_key,
)
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_session import open_session, wrap_as_direct_callback
from ground_station.adapters.called_session import ServerSession, session_reopened_message
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.fleet_inbox import FleetInbox
from ground_station.adapters.neighbour_line import NeighbourConnection, open_neighbour_connections
from ground_station.adapters.roster_share import RosterShare
from ground_station.core.fleet.certificate_ends import (
    CertificateExpiry,
    roster_certificate_expiries,
)
from ground_station.core.fleet.fleet_link import FleetInput, StateReceived

REPORTER_ROLES = {"station": WIND_STATIONS, "desk": WIND_PUBLISHERS}


class ZenohFleet:
    """The desk's connection to one fleet."""

    def __init__(
        self,
        fleet: str,
        config: Path | None,
        options: JoinOptions = DEFAULT_JOIN_OPTIONS,
        say: Callable[[str], None] = lambda words: None,
        neighbours: Sequence[str] = (),
    ) -> None:
        """Join with this configuration file (JSON5), or as `options` state. `say` logs each
        reopened session. `neighbours`: fleets whose tracks are brought to this fleet's vehicles;
        without an identity all fleets are on one network.

        Raises LeewayError if a file is invalid or the network refuses this desk.
        """
        self._say = say
        self.open_network = options.open_network
        self._keys, self._fleet = VehicleKeys(fleet, "*"), fleet
        self._identity = (
            read_identity_of_fleet_and_member(options.identity, fleet)
            if options.identity is not None
            else None
        )
        self.trust = self._identity.trust if self._identity is not None else None
        self._certificate_ends: tuple[Roster, int | None, CertificateExpiry] | None = None
        self.inbox = FleetInbox(self._verify_signature, is_member=self._is_member)
        self._server_session: ServerSession | None = None
        if config is None and self._identity is not None:
            self._server_session = ServerSession(self._identity, options.open_network)
            session = self._server_session.open_session()
        else:
            checked_config = read_and_check_zenoh_config(config, open_network=options.open_network)
            session = open_session(checked_config, config)
        self._subscribe_in_session(session)
        self._neighbours: dict[str, NeighbourConnection] = {}
        if self._identity is not None and neighbours:
            try:
                self._neighbours = open_neighbour_connections(
                    self._identity, neighbours, self._publish_neighbour_track, say
                )
            except LeewayError:
                self._session.close()
                raise

    def _subscribe_in_session(self, session: zenoh.Session) -> None:
        """Subscribe and publish in this session from now on."""
        self._session = session
        self._roster = (
            RosterShare(session, self._identity, partial(self.inbox.count_rejection, "roster"))
            if self._identity is not None
            else None
        )
        add_report = self.inbox.add_report
        self._subscribers = (  # zenoh undeclares subscribers without a reference
            *(
                session.declare_subscriber(key, wrap_as_direct_callback(partial(_add_sample, add)))
                for key, add in (
                    (self._keys.state_key, self.inbox.add_state),
                    (self._keys.event_key, self.inbox.add_event),
                    (station_wind_key(self._fleet, "*"), partial(add_report, "station")),
                    (desk_key(self._fleet, "*"), partial(add_report, "desk")),
                )
            ),
            session.liveliness().declare_subscriber(
                self._keys.alive_key(), self._on_liveliness, history=True
            ),
        )

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Return all received inputs; waits up to `wait_s` for the first."""
        if self._roster is not None:
            self._roster.poll_file_and_exchange_rosters(monotonic_s())
        if self._server_session is not None and self._server_session.poll_and_check_if_reopen_due(
            monotonic_s()
        ):
            self._reopen_session(self._server_session)
        inputs = self.inbox.wait_and_pop_inputs(wait_s)
        for line in self._neighbours.values():
            line.report_connection_and_certificate(monotonic_s())
            for one in inputs:
                if isinstance(one, StateReceived):
                    line.subscribe_near_own_vehicle(one.state)
        return inputs

    def _reopen_session(self, server_session: ServerSession) -> None:
        """Apply changed rules and certificates. Pending requests count as unanswered; messages that
        are lost in the meantime are requested again.
        """
        self._subscribe_in_session(
            server_session.close_and_reopen_session(self._session, monotonic_s())
        )
        self._say(session_reopened_message(server_session.identity.trust.roster))

    def _publish_neighbour_track(self, key: str, track_bytes: bytes) -> None:
        """Publish a neighbour's track to own vehicles. It is lost while the session reopens."""
        with contextlib.suppress(zenoh.ZError):
            self._session.put(key, track_bytes, express=True)

    def neighbour_keys(self, fleet: str) -> Mapping[str, str]:
        """Return the public keys of a neighbouring fleet's vehicles, by name."""
        line = self._neighbours.get(fleet)
        return {} if line is None else line.valid_vehicle_public_keys_by_name()

    @property
    def own_certificate_warning(self) -> str:
        """Warning about this program's own certificate or roster entry; empty: none."""
        return self.trust.certificate_warning_or_empty() if self.trust is not None else ""

    def certificate_expiry_dates(self) -> CertificateExpiry | None:
        """Return when certificates end, by the roster in force; None without an identity."""
        if self.trust is None:
            return None
        roster, end_us = self.trust.roster, self.trust.read_membership_end_us()
        if (
            self._certificate_ends is None
            or self._certificate_ends[0] is not roster
            or self._certificate_ends[1] != end_us
        ):
            self._certificate_ends = (
                roster,
                end_us,
                roster_certificate_expiries(roster, self.trust.name, end_us),
            )
        return self._certificate_ends[2]

    def request_states(self, wait_s: float) -> None:
        """Request the latest state of every member, and the liveliness tokens of the network."""
        self.inbox.clear_departed_before_liveliness_query()
        self._session.liveliness().get(
            self._keys.alive_key(), self._on_liveliness_reply, timeout=wait_s
        )
        selector = f"{self._keys.state_key}?{WIND_COV}"
        self._session.get(selector, self._on_state_reply, timeout=wait_s)

    def request_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Request the events that a member keeps after this number."""
        raws: list[bytes] = []

        def collect_event(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None or vehicle_from_key(str(sample.key_expr)) != vehicle:
                return
            if len(raws) < MAX_EVENTS_PER_REPLY:
                raws.append(sample.payload.to_bytes())

        def store_replay() -> None:
            if raws:
                self.inbox.add_events_of_query_reply(vehicle, raws)

        selector = f"{VehicleKeys(self._fleet, vehicle).event_key}?after={after}"
        self._session.get(
            selector,
            zenoh.handlers.Callback(collect_event, store_replay),
            timeout=wait_s,
            consolidation=zenoh.ConsolidationMode.NONE,  # every event has the same key
        )

    def send(self, command: Command, wait_s: float) -> None:
        """Send a command. Its response, or the time-out, arrives through `receive`."""
        results: list[Result] = []

        def collect_result(reply: zenoh.Reply) -> None:
            result = self._verify_result(reply, command.vehicle)
            if result is None or results:
                return
            if result.id == command.id:
                results.append(result)
            else:
                self.inbox.count_rejection(command.vehicle, f"rejected a command: {result.reason}")

        def store_response_or_timeout() -> None:
            self.inbox.add_command_response(command.id, results[0] if results else None)

        key = VehicleKeys(self._fleet, command.vehicle).command_key
        self._session.get(
            key,
            zenoh.handlers.Callback(collect_result, store_response_or_timeout),
            payload=self._encode_and_sign("command", command),
            timeout=wait_s,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            express=True,
        )

    def publish(self, message: SharedWinds | DeskHeartbeat) -> None:
        """Publish wind reports or a heartbeat, signed if the desk has an identity."""
        raw = self._encode_and_sign(KIND_OF_TYPE[type(message)], message)
        self._session.put(_key_of(self._fleet, message), raw, express=True)

    def _encode_and_sign(self, kind: str, message: Command | SharedWinds | DeskHeartbeat) -> bytes:
        raw = encode_message(message)
        return raw if self.trust is None else self.trust.sign_in_envelope(kind, raw)

    def close(self) -> None:
        """Leave the network."""
        for line in self._neighbours.values():
            line.close()
        self._session.close()

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        seen = vehicle_and_instance_from_key(str(sample.key_expr))
        if seen is not None:
            has_joined = sample.kind == zenoh.SampleKind.PUT
            if self._roster is not None and has_joined:
                self._roster.schedule_roster_number_announcement()
            self.inbox.record_instance_presence(*seen, has_joined=has_joined)

    def _on_liveliness_reply(self, reply: zenoh.Reply) -> None:
        if (sample := reply.ok) is not None and (
            seen := vehicle_and_instance_from_key(str(sample.key_expr))
        ) is not None:
            self.inbox.add_liveliness_reply(*seen)

    def _on_state_reply(self, reply: zenoh.Reply) -> None:
        if (sample := reply.ok) is not None:
            key, raw = str(sample.key_expr), sample.payload.to_bytes()
            self.inbox.add_state(key, raw, is_query_reply=True)

    def _verify_result(self, reply: zenoh.Reply, vehicle: str) -> Result | None:
        """Return the response of the addressed vehicle; any other reply is rejected."""
        sample = reply.ok
        if sample is None:
            return None
        verified = self._verify_signature("result", sample.payload.to_bytes(), vehicle)
        result = decode_message(Result, verified)
        if isinstance(result, Refused):
            self.inbox.count_rejection(vehicle, result.reason)
            return None
        if not result.vehicle == vehicle == vehicle_from_key(str(sample.key_expr)):
            self.inbox.count_rejection(vehicle, f"response names {result.vehicle}")
            return None
        return result

    def _is_member(self, vehicle: str) -> bool:
        """True if the roster lists it; without an identity every sender is accepted."""
        return self.trust is None or vehicle in self.trust.roster.member_by_name

    def _verify_signature(
        self, message_kind: str, message_bytes: bytes, vehicle: str
    ) -> bytes | Refused:
        """Return the message if `vehicle` signed it; without an identity, return it unchecked."""
        if self.trust is None:
            return message_bytes
        roles = REPORTER_ROLES.get(message_kind, STATE_PUBLISHERS)
        verified = self.trust.verify_message_of_signer(message_kind, message_bytes, vehicle, roles)
        if isinstance(verified, Refused):
            return Refused(f"not believed: {verified.reason}")
        return verified


def _add_sample(add: Callable[[str, bytes], None], sample: zenoh.Sample) -> None:
    """Pass the key and payload of a received message to one of the inbox's functions.

    It runs on zenoh's receiving threads: what a member sends too fast waits in its own connection,
    not in one queue before the messages of all others.
    """
    add(str(sample.key_expr), sample.payload.to_bytes())


def _key_of(fleet: str, message: SharedWinds | DeskHeartbeat) -> str:
    if isinstance(message, DeskHeartbeat):
        return desk_key(fleet, message.desk)
    return VehicleKeys(fleet, message.vehicle).wind_key
