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


def join(
    keys: VehicleKeys,
    zenoh: Path | None,
    options: JoinOptions = ON_ITS_OWN,
    wake: Callable[[], None] = lambda: None,
) -> Callable[[str], MemberLink]:
    """What opens the link of one life. Raises LeewayError for a mistake in names or files."""
    if options.identity is None:
        config = read_config(zenoh, open_network=options.open_network)
        return lambda life: ZenohLink(config, keys, life, wake)
    # cryptography takes 0.1 s to load: only a fleet with a roster pays for it
    from companion.fleet.identity import identity_of
    from companion.fleet.signed_link import SignedLink

    identity = identity_of(options.identity, keys.fleet, keys.vehicle)
    file = zenoh or identity.zenoh
    config = read_config(file, open_network=options.open_network)
    return lambda life: SignedLink(
        ZenohLink(config, keys, life, wake), identity.trust, life, wall_s
    )
