"""A wind station's end of the fleet's network: it tells its own wind, and hears nobody."""

from pathlib import Path

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.membership import ON_ITS_OWN, JoinOptions
from companion.fleet.roles import MEASURES
from companion.fleet.topics import station_key
from companion.fleet.zenoh_config import read_config
from ground_station.core.fleet.station_message import StationWind, encode_station


class ZenohStation:
    """One station's session."""

    def __init__(
        self, fleet: str, station: str, config: Path | None, options: JoinOptions = ON_ITS_OWN
    ) -> None:
        """Join as this station. LeewayError where a file is not valid, or the identity is not a
        station's of this name.
        """
        self._key, self._trust = station_key(fleet, station), None
        if options.identity is not None:
            from companion.fleet.identity import identity_of

            identity = identity_of(options.identity, fleet, station)
            self._trust, config = identity.trust, config or identity.zenoh
            me = identity.trust.me
            if me is None or me.role not in MEASURES:
                role = "not on the roster" if me is None else f"a {me.role.value}"
                raise LeewayError(f"{options.identity}: {station} is {role}, expected a station")
        try:
            self._session = zenoh.open(read_config(config, open_network=options.open_network))
        except zenoh.ZError as error:
            raise LeewayError(f"{config or 'zenoh'}: {error}") from error

    def tell(self, wind: StationWind) -> None:
        """Publish what was measured, signed where the station has an identity."""
        raw = encode_station(wind)
        self._session.put(
            self._key, raw if self._trust is None else self._trust.seal("station", raw)
        )

    def close(self) -> None:
        """Leave the network."""
        self._session.close()
