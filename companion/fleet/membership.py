"""Joining a fleet's network as a drone or truck: its configuration, signed or unsigned."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from companion.adapters.clock import wall_s
from companion.fleet.identity import read_identity_of_fleet_and_member
from companion.fleet.network import MemberLink
from companion.fleet.signed_link import SignedLink, unverified_commander_name_or_empty
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_link import ZenohLink


@dataclass(frozen=True, slots=True)
class JoinOptions:
    """Command-line options for joining. `identity`: a folder written by `ground-station pki`.

    Without a zenoh file the identity's configuration is used; without either, loopback only.
    `open_network`: strangers may be admitted.
    """

    identity: Path | None = None
    open_network: bool = False


DEFAULT_JOIN_OPTIONS = JoinOptions()
"""No options."""


@dataclass(frozen=True, slots=True)
class Membership:
    """A member's access to the network. `open_link(instance_id)` opens the link of one instance;
    `certificate_error_within(seconds)` returns the reason against an action of that duration
    (empty: none).
    """

    open_link: Callable[[str], MemberLink]
    certificate_error_within: Callable[[float], str] = lambda seconds: ""


def read_membership(
    keys: VehicleKeys,
    zenoh: Path | None,
    options: JoinOptions = DEFAULT_JOIN_OPTIONS,
    on_request: Callable[[], None] = lambda: None,
) -> Membership:
    """Read the files for joining. Raises LeewayError for invalid names or files."""
    if options.identity is None:
        config = read_and_check_zenoh_config(zenoh, open_network=options.open_network)
        return Membership(lambda instance_id: ZenohLink(config, keys, instance_id, on_request))
    identity = read_identity_of_fleet_and_member(options.identity, keys.fleet, keys.vehicle)
    trust = identity.trust
    config = read_and_check_zenoh_config(
        zenoh or identity.zenoh_config_path, open_network=options.open_network
    )

    def open_link(instance_id: str) -> MemberLink:
        link = ZenohLink(
            config,
            keys,
            instance_id,
            on_request,
            is_member=lambda name: name in trust.roster.member_by_name,
            unverified_sender=lambda raw: unverified_commander_name_or_empty(trust, raw),
            roster_number=lambda: trust.roster.number,
        )
        return SignedLink(link, trust, instance_id, wall_s)

    return Membership(open_link, trust.certificate_error_within)
