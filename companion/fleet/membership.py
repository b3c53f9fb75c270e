"""How a drone or truck joins its fleet's network: with which configuration, and signed or not."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from companion.adapters.clock import wall_s
from companion.fleet.network import MemberLink
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import ZenohLink


@dataclass(frozen=True, slots=True)
class JoinOptions:
    """What a person may say about joining. `identity`: the folder that `ground-station pki` made.

    Without a zenoh file the identity's own configuration holds; without either, loopback only.
    `open_network`: strangers may be let in.
    """

    identity: Path | None = None
    open_network: bool = False


ON_ITS_OWN = JoinOptions()
"""Nothing said."""


@dataclass(frozen=True, slots=True)
class Membership:
    """How a member joins. `open_link(life)` opens the link of one life; `trouble_until(seconds)`
    says why it may begin nothing that takes so long (empty: it may).
    """

    open_link: Callable[[str], MemberLink]
    trouble_until: Callable[[float], str] = lambda seconds: ""


def join(
    keys: VehicleKeys,
    zenoh: Path | None,
    options: JoinOptions = ON_ITS_OWN,
    wake: Callable[[], None] = lambda: None,
) -> Membership:
    """Read what joining takes. Raises LeewayError for a mistake in names or files."""
    if options.identity is None:
        config = read_config(zenoh, open_network=options.open_network)
        return Membership(lambda life: ZenohLink(config, keys, life, wake))
    # cryptography takes 0.1 s to load: only a fleet with a roster pays for it
    from companion.fleet.identity import identity_of
    from companion.fleet.signed_link import SignedLink, claimed_by

    identity = identity_of(options.identity, keys.fleet, keys.vehicle)
    trust = identity.trust
    config = read_config(zenoh or identity.zenoh, open_network=options.open_network)

    def open_link(life: str) -> MemberLink:
        link = ZenohLink(
            config,
            keys,
            life,
            wake,
            is_member=lambda name: name in trust.roster.by_name,
            claimed_by=lambda raw: claimed_by(trust, raw),
            roster_number=lambda: trust.roster.number,
        )
        return SignedLink(link, trust, life, wall_s)

    return Membership(open_link, trust.trouble_until)
